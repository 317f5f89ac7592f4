"""Surfaces from labels: no shrinkage, the right piece, the right place."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import CycleTiming, Grid, InvalidInputError, Preop, VolumeSeries
from dvf_ig.preop import check_model, model_from_labels
from dvf_ig.preop.surface.from_labels import border_caps, surfaces_from_labels

TIMING = CycleTiming.uniform(2, 0.8)


def ball_labels(radius, voxel, direction=None, center=(0.3, -0.2, 0.1), shift=(0.0, 0.0, 0.0)):
    n = int(2 * (radius + 6) / voxel)
    direction = np.eye(3) if direction is None else direction
    corner = np.array(center) - direction @ np.full(3, (n - 1) / 2 * voxel)
    grid = Grid("mr", (n, n, n), corner, np.full(3, voxel), direction)
    inside = np.linalg.norm(grid.centers_mm() - center - shift, axis=-1) < radius
    return VolumeSeries(grid, np.stack([inside, inside]).astype(np.uint8), TIMING)


@pytest.mark.parametrize(("radius", "voxel"), [(12.0, 0.6), (15.0, 1.5), (15.0, 2.0), (30.0, 2.0)])
def test_smoothing_does_not_shrink_a_sphere(radius, voxel):
    """Averaged over places in the voxel grid, whose own counting error is about 0.05 voxels a place."""
    rng = np.random.default_rng(7)
    means, scatter = [], []
    for center in rng.uniform(-voxel / 2, voxel / 2, size=(8, 3)):
        mesh = surfaces_from_labels(ball_labels(radius, voxel, center=(0, 0, 0), shift=center), (1,))[0]
        off = np.linalg.norm(mesh.vertices_mm - center, axis=1) - radius
        means.append(off.mean())
        scatter.append(off.std())
        assert mesh.volume_mm3() > 0
    smoothed_mm = max(voxel, 2 * voxel if voxel < 0.625 else 0.0)
    plain_gaussian_mm = smoothed_mm**2 / radius
    assert abs(np.mean(means)) < 0.3 * plain_gaussian_mm
    assert np.mean(scatter) < 0.1 * voxel


def test_oblique_grids_give_the_same_place():
    turned = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    mesh = surfaces_from_labels(ball_labels(15.0, 2.0, turned), (1,))[0]
    np.testing.assert_allclose(mesh.vertices_mm.mean(axis=0), (0.3, -0.2, 0.1), atol=0.1)
    assert mesh.volume_mm3() > 0


def test_only_the_largest_piece_of_the_organ_counts_and_holes_are_filled():
    series = ball_labels(15.0, 2.0)
    values = series.values.copy()
    clean = surfaces_from_labels(series, (1,))[0]
    values[:, 1, 1, 1] = 1
    values[:, -3:, -3:, -3:] = 7
    values[:, 10:12, 10:12, 10:12] = 0
    dirty = surfaces_from_labels(VolumeSeries(series.grid, values, TIMING), (1,))[0]
    assert np.array_equal(clean.triangles, dirty.triangles)
    np.testing.assert_allclose(clean.vertices_mm, dirty.vertices_mm, atol=1e-5)


def test_where_the_image_cuts_the_organ_the_surface_is_a_cap():
    series = ball_labels(15.0, 2.0)
    grid = Grid.axis_aligned("mr", (21, 21, 12), series.grid.origin_mm, 2.0)
    cut = VolumeSeries(grid, series.values[:, :21, :21, :12], TIMING)
    mesh = surfaces_from_labels(cut, (1,))[0]
    caps = border_caps(mesh, grid)
    assert caps.any()
    assert mesh.vertices_mm[mesh.triangles[caps]][..., 2].min() > grid.to_mm(np.array([0, 0, 10.0]))[2] - 1.0


def test_model_from_labels():
    preop = Preop("ball", labels=ball_labels(20.0, 2.0), organ_labels=(1,), surface="HEART")
    model = model_from_labels(preop)
    assert model.surface_name == "HEART"
    assert check_model(model, points_per_phase=300, rng=np.random.default_rng(0)).mean_mm < 0.05


def test_refusals():
    series = ball_labels(15.0, 2.0)
    with pytest.raises(InvalidInputError, match="no organ labels"):
        surfaces_from_labels(series, ())
    with pytest.raises(
        InvalidInputError, match=r"phase 0 .* no voxel of the organ labels \[5\].*present are \[0, 1\]"
    ):
        surfaces_from_labels(series, (5,))
    with pytest.raises(InvalidInputError, match="no label image"):
        model_from_labels(Preop("ball"))
