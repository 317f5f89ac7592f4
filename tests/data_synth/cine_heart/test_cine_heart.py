"""The heart of a real cine: smooth surfaces of thick slices, drawn from end-diastole to end-systole."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from data_synth.cine_heart.anatomy import (
    LV_LABEL,
    MYOCARDIUM_LABEL,
    RV_LABEL,
    VALVE_PLANE_MM,
    CineHeart,
    cine_anatomy,
)
from data_synth.cine_heart.carried import contraction, displacement, outline
from data_synth.cine_heart.label_depth import Caps, stack_depth
from data_synth.heart.tissue import BLOOD, Tissue
from data_synth.surfaces.anatomy import EPICARDIAL, LV, SurfaceAnatomy
from dvf_ig.core import CycleTiming, FloatArray, Grid, InvalidInputError, Volume, VolumeSeries
from dvf_ig.core.space.mesh import enclosed_volume_mm3

PHASES, ES = 10, 4
GRID = Grid("mr", (60, 50, 7), np.array([-60.0, -50.0, -30.0]), np.array([2.0, 2.0, 10.0]), np.eye(3))
ED_MM, ES_MM, OUTER_MM = 26.0, 19.0, 35.0
LEFT, RIGHT = np.array([10.0, 0.0]), np.array([-28.0, 0.0])


def labels(inner_mm: float, outer_mm: float) -> NDArray[np.uint8]:
    """Ventricles that narrow towards the last slice, the apical one."""
    nodes = GRID.to_mm(
        np.stack(np.meshgrid(*map(np.arange, GRID.shape), indexing="ij"), axis=-1, dtype=float)
    )
    narrow = 1.0 - 0.5 * (nodes[..., 2] + 30.0) / 60.0
    left = np.linalg.norm(nodes[..., :2] - LEFT, axis=-1) / narrow
    right = np.linalg.norm((nodes[..., :2] - RIGHT) / [1.0, 1.2], axis=-1) / narrow
    out = np.zeros(GRID.shape, dtype=np.uint8)
    out[right < 24.0] = RV_LABEL
    out[left < outer_mm] = MYOCARDIUM_LABEL
    out[left < inner_mm] = LV_LABEL
    return out


def grey(now: NDArray[np.uint8]) -> FloatArray:
    return np.array([30.0, 200.0, 80.0, 220.0])[now]


@pytest.fixture(scope="module")
def heart() -> CineHeart:
    share = np.sin(np.pi * np.minimum(np.arange(PHASES) / (2 * ES), 1.0)) ** 2
    series = [grey(labels(ED_MM + s * (ES_MM - ED_MM), OUTER_MM - 2.0 * s)) for s in share]
    cine = VolumeSeries(GRID, np.array(series, dtype=np.float32), CycleTiming.uniform(PHASES, 0.9))
    still, moved = (Volume(GRID, labels(*sizes)) for sizes in ((ED_MM, OUTER_MM), (ES_MM, OUTER_MM - 2.0)))
    return CineHeart("somebody", cine, still, moved, ES)


@pytest.fixture(scope="module")
def anatomy(heart: CineHeart) -> SurfaceAnatomy:
    return cine_anatomy(heart, mismatch_mm=0.0, seed=1)


def on_circle(radius_mm: float, height_mm: float) -> FloatArray:
    angle = np.linspace(0.0, 2 * np.pi, 40, endpoint=False)
    ring = LEFT + radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.column_stack([ring, np.full(40, height_mm)])


def test_surface_between_slices_has_no_stairs(heart: CineHeart) -> None:
    depth = stack_depth(
        np.asarray(heart.ed_labels.values) == LV_LABEL, GRID, Caps(8.0, 0.8, 0.0), base_first=True
    )
    for height in np.arange(-22.0, 22.0, 2.5):
        radius = ED_MM * (1.0 - 0.5 * (height + 30.0) / 60.0)
        assert np.abs(depth.at(on_circle(radius, height))).max() < 1.2
    # closed beyond both ends: flat at the base, round at the apex
    axis = np.array([[*LEFT, -30.0 - 5.0], [*LEFT, -30.0 - 12.0], [*LEFT, 30.0 + 7.0], [*LEFT, 30.0 + 14.0]])
    assert (depth.at(axis) > 0).tolist() == [True, False, True, False]


def test_end_diastole_is_drawn_onto_end_systole() -> None:
    caps = Caps(8.0, 0.8, 0.0)
    still, moved = (
        stack_depth(labels(size, OUTER_MM) == LV_LABEL, GRID, caps, base_first=True)
        for size in (ED_MM, ES_MM)
    )
    vertices, triangles = outline(still)
    there = vertices + displacement(vertices, triangles, moved)
    assert np.percentile(np.abs(moved.at(there)), 95) < 0.5
    assert enclosed_volume_mm3(there, triangles) < 0.65 * enclosed_volume_mm3(vertices, triangles)


def test_the_cine_sets_the_pace(heart: CineHeart) -> None:
    pace = contraction(heart.cine, np.asarray(heart.ed_labels.values) > 0, ES)
    assert pace[0] == 0.0
    assert pace[ES] == pytest.approx(1.0)
    assert (np.diff(pace[: ES + 1]) > 0).all()
    assert (np.diff(pace[ES : 2 * ES]) < 0).all()


def test_cavity_and_wall_beat_as_labelled(heart: CineHeart, anatomy: SurfaceAnatomy) -> None:
    assert anatomy.es_fraction == pytest.approx(ES / PHASES)
    for phase, size in ((0.0, ED_MM), (ES / PHASES, ES_MM)):
        for height in (-20.0, 0.0, 15.0):
            radius = size * (1.0 - 0.5 * (height + 30.0) / 60.0)
            inside = anatomy.tissue(on_circle(radius - 2.0, height), phase)
            assert (inside == Tissue.LV_BLOOD).mean() > 0.95
            assert np.isin(anatomy.tissue(on_circle(radius + 2.0, height), phase), BLOOD).mean() < 0.1
    assert anatomy.surface_vertices(0.0).shape == anatomy.surface_vertices(0.4).shape
    assert {EPICARDIAL, LV} <= set(anatomy.closed)


def test_atria_begin_beyond_the_basal_slice(anatomy: SurfaceAnatomy) -> None:
    height = -30.0 - VALVE_PLANE_MM
    codes = anatomy.tissue(
        np.array([[*LEFT, height - 6.0], [*RIGHT, height - 6.0], [*LEFT, height + 1.5]]), 0.0
    )
    assert codes.tolist() == [Tissue.LA_BLOOD, Tissue.RA_BLOOD, Tissue.ATRIAL_WALL]


def test_what_the_laboratory_has_is_the_real_cine_and_end_diastolic_labels(heart: CineHeart) -> None:
    preop = heart.preop()
    assert preop.mr is heart.cine
    assert preop.labels is None
    assert preop.ed_labels is not None
    assert np.array_equal(preop.ed_labels.values, heart.ed_labels.values)
    assert preop.lv_label == LV_LABEL
    assert preop.blood_labels == (LV_LABEL, RV_LABEL)


def test_bad_hearts_are_refused(heart: CineHeart) -> None:
    with pytest.raises(InvalidInputError, match="end-systole is phase 10"):
        replace(heart, es_phase=PHASES)
    thin = np.zeros(GRID.shape, dtype=np.uint8)
    thin[20:30, 20:30, 3] = LV_LABEL
    with pytest.raises(InvalidInputError, match="needed at least 3"):
        stack_depth(thin > 0, GRID, Caps(8.0, 0.8, 0.0), base_first=True)


def test_cine_without_a_voxel_size_is_refused(heart: CineHeart) -> None:
    lost = Grid("mr", GRID.shape, GRID.origin_mm, np.array([1.0, 1.0, 1.0]), GRID.direction)
    with pytest.raises(InvalidInputError, match="--voxel-mm"):
        replace(heart, cine=replace(heart.cine, grid=lost))
