"""Real-surface anatomy: closing open series, exact vertices, tissue that agrees with the surfaces."""

import re
import tarfile
from pathlib import Path

import numpy as np
import pytest

from data_synth.heart.motion import InverseMotion
from data_synth.heart.tissue import Tissue
from data_synth.surfaces.anatomy import EPICARDIAL, LV, SurfaceAnatomy, depth_grid, surface_anatomy
from data_synth.surfaces.closing import closed_series, refined
from data_synth.surfaces.motion import SurfaceMotion, dense_motion
from dvf_ig.core import CycleTiming, FloatArray, IntArray, InvalidInputError, SurfaceSeries
from dvf_ig.core.space.mesh import enclosed_volume_mm3

PHASES = 8
CENTER = np.array([12.0, -20.0, 30.0])


def open_sphere(radius: float, rings: int = 24, sectors: int = 40) -> tuple[FloatArray, IntArray]:
    """A sphere without its two polar caps: two boundary loops."""
    latitude = np.linspace(0.35, np.pi - 0.35, rings)
    longitude = np.linspace(0, 2 * np.pi, sectors, endpoint=False)
    theta, phi = np.meshgrid(latitude, longitude, indexing="ij")
    unit = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    index = np.arange(rings * sectors).reshape(rings, sectors)
    a, b = index[:-1], np.roll(index[:-1], -1, axis=1)
    c, d = index[1:], np.roll(index[1:], -1, axis=1)
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])
    return radius * unit.reshape(-1, 3) + CENTER, triangles


def beating(name: str, radius: float, frame: str = "mr") -> SurfaceSeries:
    vertices, triangles = open_sphere(radius)
    strain = 1 - 0.1 * np.sin(np.pi * np.arange(PHASES) / PHASES) ** 2
    series = CENTER + strain[:, None, None] * (vertices - CENTER)
    return SurfaceSeries(name, frame, series, triangles, CycleTiming.uniform(PHASES, 0.9), "ball")


@pytest.fixture(scope="module")
def anatomy() -> SurfaceAnatomy:
    return surface_anatomy(
        {EPICARDIAL: beating(EPICARDIAL, 30.0), LV: beating(LV, 22.0)}, mismatch_mm=0.0, seed=1
    )


def is_closed(triangles: IntArray) -> bool:
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forward = {tuple(e) for e in edges.tolist()}
    return len(forward) == len(edges) and all((b, a) in forward for a, b in forward)


def test_open_surface_is_capped_and_outward() -> None:
    closed = closed_series(beating(EPICARDIAL, 30.0))
    assert len(closed.openings) == 2
    assert is_closed(closed.triangles)
    volumes = [enclosed_volume_mm3(v, closed.triangles) for v in closed.vertices_mm]
    height = 30 * np.cos(0.35)
    barrel = 2 * np.pi * (900 * height - height**3 / 3)
    assert volumes[0] == pytest.approx(barrel, rel=0.02)
    finer = refined(closed)
    assert is_closed(finer.triangles)
    assert enclosed_volume_mm3(finer.vertices_mm[0], finer.triangles) == pytest.approx(volumes[0])


def test_pieces_with_doubled_vertices_and_opposite_turns_are_welded() -> None:
    vertices, triangles = open_sphere(30.0)
    half = len(triangles) // 2
    doubled = np.concatenate([vertices, vertices])
    split = np.concatenate([triangles[:half], triangles[half:, ::-1] + len(vertices)])
    series = SurfaceSeries("S", "mr", np.stack([doubled, doubled]), split, CycleTiming.uniform(2, 1.0), "p")
    closed = closed_series(series)
    assert is_closed(closed.triangles)
    assert enclosed_volume_mm3(closed.vertices_mm[0], closed.triangles) > 0


def test_broken_mesh_is_refused() -> None:
    vertices, triangles = open_sphere(30.0)
    crowded = np.concatenate([triangles, [[0, triangles[0, 1], 500]], [[0, triangles[0, 1], 600]]])
    series = SurfaceSeries(
        "S", "mr", np.stack([vertices, vertices]), crowded, CycleTiming.uniform(2, 1.0), "p"
    )
    with pytest.raises(InvalidInputError, match="more than two triangles"):
        closed_series(series)


def test_depth_grid_is_the_distance_to_a_sphere() -> None:
    vertices, triangles = open_sphere(30.0, 60, 110)
    series = np.stack([vertices, vertices])
    closed = closed_series(SurfaceSeries("S", "mr", series, triangles, CycleTiming.uniform(2, 1.0), "p"))
    box = np.array([CENTER - 40, CENTER + 40])
    grid = depth_grid(closed.vertices_mm[0], closed.triangles, box, 2.0, 6.0)
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction = direction[np.abs(direction[:, 2]) < 0.7]
    radius = rng.uniform(26, 34, len(direction))
    # trilinear interpolation of a sphere of 30 mm on 2 mm nodes: h²/(4R) and the facets' sagitta
    assert np.abs(grid.at(CENTER + radius[:, None] * direction) - (30 - radius)).max() < 0.08


def test_surface_vertices_are_the_interpolated_ones(anatomy: SurfaceAnatomy) -> None:
    original = beating(EPICARDIAL, 30.0)
    assert len(anatomy.surface_vertices(0.0)) >= 8000
    for i in (0, 3):
        vertices = anatomy.surface_vertices(i / PHASES)
        offsets = np.linalg.norm(vertices[None, :50] - original.vertices_mm[i][:, None], axis=-1).min(axis=0)
        assert offsets.max() < 1e-9
    assert np.allclose(anatomy.surface_vertices(0.0), anatomy.surface_vertices(1.0))
    assert is_closed(anatomy.surface_triangles)


def test_tissue_agrees_with_the_moving_surfaces(anatomy: SurfaceAnatomy) -> None:
    for phase in (0.0, 0.3, 0.5):
        depth = anatomy.shapes.organ(anatomy.material(anatomy.surface_vertices(phase)[::5], phase))
        assert np.sqrt((depth**2).mean()) < 0.25
        table = anatomy.shapes.organ(
            anatomy.inverse_motion.pull_back(anatomy.surface_vertices(phase)[::5], phase)
        )
        assert np.sqrt((table**2).mean()) < 0.35
        codes = anatomy.tissue(CENTER + np.array([[0.0, 0, 0], [23.5, 0, 0], [36.0, 0, 0]]), phase)
        assert codes.tolist()[:2] == [Tissue.LV_BLOOD, Tissue.LV_MYOCARDIUM]
        assert codes[2] not in (Tissue.LV_BLOOD, Tissue.LV_MYOCARDIUM)


def test_dense_motion_reproduces_a_uniform_strain() -> None:
    series = beating(EPICARDIAL, 30.0)
    box = np.array([CENTER - 35, CENTER + 35])
    motion = dense_motion(series.vertices_mm, series.timing, series.vertices_mm[0], box)
    direction = np.array([[1.0, 0, 0], [0, 1.0, 0], [0.6, 0.6, 0.5]])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = CENTER + 30 * direction
    back = SurfaceMotion(motion, motion.backward()).pull_back(CENTER + 27 * direction, 0.5)
    assert np.linalg.norm(back - points, axis=1).max() < 0.3


def test_imaging_inverts_the_dense_motion(anatomy: SurfaceAnatomy) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(*anatomy.box_mm, (4000, 3))
    phases = rng.uniform(0, 1, 4000)
    there = anatomy.inverse_motion.pull_back(points, phases)
    dense = anatomy.dense
    forward = InverseMotion(dense.forward_mm, dense.origin_mm, dense.spacing_mm)
    assert np.linalg.norm(forward.pull_back(there, phases) - points, axis=1).max() < 0.05


def test_targets_landmarks_and_preop(anatomy: SurfaceAnatomy) -> None:
    assert len(anatomy.targets().names) >= 10 + 27
    assert 6 <= len(anatomy.landmarks().names) <= 8
    preop = anatomy.preop()
    assert [s.name for s in preop.surfaces] == [EPICARDIAL, LV]
    assert preop.surfaces[0].vertices_mm.shape == beating(EPICARDIAL, 30.0).vertices_mm.shape
    assert preop.patient_id == "ball"
    assert anatomy.es_fraction == pytest.approx(0.5)


def test_bad_surface_sets_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="needed at least EPICARDIAL"):
        surface_anatomy({LV: beating(LV, 22.0)}, mismatch_mm=0.0, seed=1)
    with pytest.raises(InvalidInputError, match="needed frame 'mr'"):
        surface_anatomy({EPICARDIAL: beating(EPICARDIAL, 30.0, "ct")}, mismatch_mm=0.0, seed=1)


def read_obj(text: str) -> tuple[FloatArray, IntArray]:
    vertices = [[float(x) for x in m.split()] for m in re.findall(r"^v (.+)$", text, re.M)]
    faces = [[int(x.split("/")[0]) - 1 for x in m.split()] for m in re.findall(r"^f (.+)$", text, re.M)]
    return np.array(vertices), np.array(faces, dtype=np.int64)


@pytest.mark.parametrize(
    ("name", "openings"), [("EPICARDIAL", 4), ("LV_ENDOCARDIAL", 2), ("RV_ENDOCARDIAL", 2)]
)
def test_real_surfaces_close(data_dir: Path, name: str, openings: int) -> None:
    """Six of the 25 phases of the real patient; its left ventricle goes from 158 to 57 ml in open form."""
    archive = data_dir / "bivme-cine" / "fitted_models_obj_and_guidepoints.tar.gz"
    if not archive.is_file():
        pytest.skip(f"real surfaces not found at {archive}")
    phases = (0, 4, 9, 13, 17, 21)
    meshes = {}
    with tarfile.open(archive) as tar:
        for member in tar:
            found = re.search(rf"patient1_{name}_(\d+)\.obj$", member.name)
            if found and int(found[1]) in phases and "default" in member.name:
                stream = tar.extractfile(member)
                assert stream is not None
                meshes[int(found[1])] = read_obj(stream.read().decode())
    vertices = np.array([meshes[i][0] for i in phases])
    timing = CycleTiming(np.array(phases) / 25, 0.87)
    closed = closed_series(SurfaceSeries(name, "mr", vertices, meshes[0][1], timing, "patient1"))
    assert len(closed.openings) == openings
    assert is_closed(closed.triangles)
    volumes = [enclosed_volume_mm3(v, closed.triangles) for v in closed.vertices_mm]
    assert min(volumes) > 5e4
    assert int(np.argmin(volumes)) in (2, 3)
