"""The comparison of distance maps, on a ball with bumps."""

import json

import numpy as np
import pytest
import typer
from skimage.measure import marching_cubes
from typer.testing import CliRunner

from dvf_ig.cli.study.distance import distance_maps
from dvf_ig.core import InvalidInputError, Mesh
from dvf_ig.io import write_mesh
from dvf_ig.preop import angle_deg
from dvf_ig.study.distance.maps import METHODS, SURFACE_FIRST, compare_distance_maps

app = typer.Typer()
app.command()(distance_maps)


def depth(p):
    bump = np.sin(0.25 * p[..., 0]) * np.cos(0.3 * p[..., 1])
    return 20.0 - np.linalg.norm(p, axis=-1) + 1.5 * bump


@pytest.fixture(scope="module")
def ball() -> Mesh:
    axis = np.arange(-24.0, 24.1, 1.0)
    field = depth(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1))
    vertices, triangles, _, _ = marching_cubes(field, 0.0)
    mesh = Mesh("mr", vertices.astype(float) - 24.0, triangles.astype(np.int64))
    return mesh if mesh.volume_mm3() > 0 else Mesh("mr", mesh.vertices_mm, mesh.triangles[:, ::-1])


@pytest.fixture(scope="module")
def found(ball):
    return compare_distance_maps([ball], [np.random.default_rng(1)], voxels=48, points=4000)


def test_every_method_is_scored_in_order(found):
    assert [score.name for score in found.scores] == list(METHODS)
    voxel_mm = found.grid.spacing_mm[0]
    assert max(found.grid.shape) == 49
    for score in found.scores:
        assert score.distance_mm.shape == found.grid.shape
        assert score.rms_near_mm < 1.0 * voxel_mm


def test_exact_beats_smoothed_beats_masks(found):
    by = {score.name: score for score in found.scores}
    exact, first = by["exact to the mesh"], by[SURFACE_FIRST]
    smoothed = by["Gaussian, marching cubes, exact"]
    masks = [score for score in found.scores if score not in (exact, first, smoothed)]
    assert exact.rms_near_mm == 0.0
    assert first.surface_mean_mm < exact.surface_mean_mm < 0.25 * smoothed.surface_mean_mm
    for mask in masks:
        assert smoothed.surface_mean_mm < mask.surface_mean_mm
        assert smoothed.normal_median_deg < 0.7 * mask.normal_median_deg
        assert smoothed.map_normal_median_deg < 0.7 * mask.map_normal_median_deg


def test_half_a_voxel_is_what_the_corrections_take_away(found):
    by = {score.name: score for score in found.scores}
    half = 0.5 * found.grid.spacing_mm[0]
    shift = by["Euclidean on the mask, -h/2"].distance_mm - by["Euclidean on the mask"].distance_mm
    np.testing.assert_allclose(np.abs(shift), half)
    shift = by["SimpleITK SignedMaurer, +h/2"].distance_mm - by["SimpleITK SignedMaurer"].distance_mm
    np.testing.assert_allclose(shift, half)
    for name in ("Euclidean on the mask", "SimpleITK SignedMaurer"):
        corrected = next(score for score in found.scores if score.name.startswith(f"{name}, "))
        assert corrected.rms_near_mm < by[name].rms_near_mm


def test_directions_are_held_against_the_true_shape(found):
    """The exact map's own directions, against the closed form: the reference is good to a degree."""
    near = np.abs(found.exact_mm) < 2.0
    h = 1e-3
    points = found.grid.centers_mm()[near]
    true = np.stack([depth(points + h * e) - depth(points - h * e) for e in np.eye(3)], axis=-1)
    slopes = np.stack([slope[near] for slope in np.gradient(found.exact_mm)], axis=-1)
    assert np.median(angle_deg(slopes, true)) < 2.0


def test_too_few_voxels_are_refused(ball):
    with pytest.raises(InvalidInputError, match="at least 24"):
        compare_distance_maps([ball], [np.random.default_rng(1)], voxels=8)


def test_errors_of_several_surfaces_are_pooled(ball):
    rngs = [np.random.default_rng(seed) for seed in (1, 2, 1, 2)]
    single = [compare_distance_maps([ball], [rng], voxels=24, points=400).scores for rng in rngs[:2]]
    both = compare_distance_maps([ball, ball], rngs[2:], voxels=24, points=400).scores
    for pooled, one, other in zip(both, *single, strict=True):
        assert pooled.surface_mean_mm == pytest.approx((one.surface_mean_mm + other.surface_mean_mm) / 2)
        assert pooled.rms_near_mm == pytest.approx(one.rms_near_mm)


def test_command(ball, tmp_path):
    write_mesh(ball, tmp_path / "ball.ply")
    arguments = [str(tmp_path / "ball.ply"), "-o", str(tmp_path / "out"), "--voxels", "32", "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert [row["name"] for row in report["rows"]] == list(METHODS)
    assert json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8")) == report
    assert (tmp_path / "out" / "distance.png").read_bytes().startswith(b"\x89PNG")
    write_mesh(Mesh("mr", ball.vertices_mm, ball.triangles[1:]), tmp_path / "torn.ply")
    torn = CliRunner().invoke(app, [str(tmp_path / "torn.ply"), "-o", str(tmp_path / "out")])
    assert torn.exit_code == 3
    assert "3 open edges" in torn.stderr
