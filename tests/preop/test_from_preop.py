"""The patient's model from labels of every phase, from MR with labels of end-diastole, or from surfaces."""

from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, DvfModel, Grid, InvalidInputError, Preop, SurfaceSeries, VolumeSeries
from dvf_ig.preop import ModelOptions, model_from_preop

VOXEL_MM = 2.0
SCALES = (1.0, 0.9, 0.86, 0.94)
OUTER_MM, LEFT_MM, RIGHT_MM = 18.0, 7.0, 5.0
LEFT, RIGHT = np.array([0.0, 5.0, 0.0]), np.array([0.0, -9.5, 0.0])
"""Where the cavities' centres are at end-diastole."""
WALL, LV, RV = 2, 3, 1
NAMES = ((WALL, "lv_myocardium"), (LV, "lv_blood"), (RV, "RV cavity"))
COARSE = ModelOptions(knot_spacing_mm=5.0, margin_mm=6.0)


@pytest.fixture(scope="module")
def ball() -> Preop:
    """A ball with two cavities that contracts: grey levels and labels of every phase."""
    grid = Grid.axis_aligned("mr", (28, 28, 28), np.full(3, -27.0), VOXEL_MM)
    rng = np.random.default_rng(5)
    images, labels = [], []
    for scale in SCALES:
        q = grid.centers_mm() / scale
        depths = [
            radius - np.linalg.norm(q - center, axis=-1)
            for radius, center in ((OUTER_MM, np.zeros(3)), (LEFT_MM, LEFT), (RIGHT_MM, RIGHT))
        ]
        outer, left, right = (1.0 / (1.0 + np.exp(-d / 0.7)) for d in depths)
        grey = 100 + 250 * outer + 450 * np.maximum(left, right) + 30 * np.sin(0.4 * q).sum(axis=-1)
        images.append(grey + 5 * rng.standard_normal(grey.shape))
        codes = np.where(depths[0] > 0, WALL, 0)
        labels.append(np.where(depths[1] > 0, LV, np.where(depths[2] > 0, RV, codes)))
    timing = CycleTiming.uniform(len(SCALES), 0.9)
    return Preop(
        "ball",
        mr=VolumeSeries(grid, np.stack(images).astype(np.int16), timing),
        labels=VolumeSeries(grid, np.stack(labels).astype(np.uint8), timing),
        label_names=NAMES,
        organ_labels=(WALL, LV, RV),
    )


@pytest.fixture(scope="module")
def of_end_diastole(ball: Preop) -> Preop:
    assert ball.labels is not None
    return replace(ball, labels=None, ed_labels=ball.labels.phase(0))


def check_chambers(model: DvfModel) -> None:
    """Each wall to a fifth of a voxel, which is what voxels leave unknown."""
    assert model.es_fraction == 0.5
    assert {c.name for c in model.chambers} == {"lv_blood", "RV cavity"}
    for chamber in model.chambers:
        radius, center = (LEFT_MM, LEFT) if chamber.name == "lv_blood" else (RIGHT_MM, RIGHT)
        for i, scale in enumerate(SCALES):
            off = np.linalg.norm(chamber.phase(i).vertices_mm - scale * center, axis=1) - scale * radius
            assert np.abs(off).mean() < 0.2 * VOXEL_MM
            assert chamber.phase(i).volume_mm3() > 0


def test_labels_of_every_phase_give_the_chambers_that_their_names_tell(ball: Preop) -> None:
    check_chambers(model_from_preop(ball, options=COARSE))


@pytest.fixture(scope="module")
def model_of_end_diastole(of_end_diastole: Preop) -> DvfModel:
    return model_from_preop(of_end_diastole, options=COARSE)


def test_labels_of_end_diastole_go_with_the_motion(model_of_end_diastole: DvfModel) -> None:
    check_chambers(model_of_end_diastole)
    for mesh, scale in zip(model_of_end_diastole.reference, SCALES, strict=True):
        assert np.abs(np.linalg.norm(mesh.vertices_mm, axis=1) - OUTER_MM * scale).mean() < 0.2 * VOXEL_MM


def test_unnamed_labels_are_told_by_their_values(
    of_end_diastole: Preop, model_of_end_diastole: DvfModel
) -> None:
    """All but 0 is the organ; the first cavity is the left ventricle's, whose volume gives end-systole."""
    unnamed = replace(of_end_diastole, label_names=(), organ_labels=(), cavity_labels=(LV, RV))
    model = model_from_preop(unnamed, options=COARSE)
    assert [c.name for c in model.chambers] == ["label 3", "label 1"]
    assert np.array_equal(model.coefficients, model_of_end_diastole.coefficients)
    without = model_from_preop(replace(unnamed, cavity_labels=()), options=COARSE)
    assert without.chambers == ()


def test_which_labels_are_blood() -> None:
    named = Preop("p", label_names=(*NAMES, (7, "la_blood")), organ_labels=(WALL, LV, RV))
    assert named.blood_labels == (LV, RV)
    assert named.lv_label == LV
    assert replace(named, organ_labels=()).blood_labels == (LV, RV, 7)
    told = replace(named, cavity_labels=(RV, LV))
    assert (told.blood_labels, told.lv_label) == ((RV, LV), RV)
    assert (Preop("p").blood_labels, Preop("p").lv_label) == ((), None)


def test_a_label_that_a_phase_lacks_is_no_chamber(ball: Preop, caplog: pytest.LogCaptureFixture) -> None:
    assert ball.labels is not None
    values = ball.labels.values.copy()
    values[2][values[2] == RV] = WALL
    model = model_from_preop(replace(ball, labels=replace(ball.labels, values=values)), options=COARSE)
    assert [c.name for c in model.chambers] == ["lv_blood"]
    assert "RV cavity is left out of the blood chambers: in phase 2" in caplog.text


def test_surfaces_of_ventricles_are_the_chambers(beating_sphere: SurfaceSeries) -> None:
    lv, rv, other = (
        replace(beating_sphere, name=name, vertices_mm=scale * beating_sphere.vertices_mm)
        for name, scale in (("LV_ENDOCARDIAL", 0.4), ("RV_ENDOCARDIAL", 0.3), ("AORTA", 0.1))
    )
    preop = Preop("ball", surfaces=(beating_sphere, lv, rv, other))
    model = model_from_preop(preop, options=COARSE)
    assert [c.name for c in model.chambers] == ["LV_ENDOCARDIAL", "RV_ENDOCARDIAL"]
    np.testing.assert_allclose(model.chambers[0].phase(2).vertices_mm, lv.vertices_mm[2], atol=1e-5)
    late = replace(rv, timing=CycleTiming(np.array([0.1, 0.3, 0.7]), 0.85))
    with pytest.raises(InvalidInputError, match="EPICARDIAL and RV_ENDOCARDIAL have different phase times"):
        model_from_preop(replace(preop, surfaces=(beating_sphere, late)), options=COARSE)


def test_what_gives_no_model_says_what_would(of_end_diastole: Preop) -> None:
    with pytest.raises(InvalidInputError, match="'p' give no model: needed a model file, labels of every"):
        model_from_preop(Preop("p"))
    with pytest.raises(InvalidInputError, match="give the 4-D image"):
        model_from_preop(replace(of_end_diastole, mr=None))
