"""The heart of a session: from a model file alone, with MR, with or without chambers of blood."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, DvfModel, Grid, InvalidInputError, Preop, SurfaceSeries, VolumeSeries
from dvf_ig.preop import ModelOptions, model_from_preop
from dvf_ig.session import build_heart, label_map, label_map_of_model


@pytest.fixture(scope="module")
def surfaces(beating_sphere: SurfaceSeries) -> Preop:
    cavity = replace(beating_sphere, name="LV_ENDOCARDIAL", vertices_mm=0.5 * beating_sphere.vertices_mm)
    return Preop("ball", surfaces=(beating_sphere, cavity))


@pytest.fixture(scope="module")
def model(surfaces: Preop) -> DvfModel:
    return model_from_preop(surfaces, options=ModelOptions(knot_spacing_mm=6.0, margin_mm=6.0))


def mr_at(center_mm: float) -> VolumeSeries:
    """Noise of five phases about a place."""
    grid = Grid.axis_aligned("mr", (16, 16, 16), np.full(3, center_mm - 30.0), 4.0)
    values = np.random.default_rng(1).integers(0, 900, (5, *grid.shape)).astype(np.int16)
    return VolumeSeries(grid, values, CycleTiming.uniform(5, 0.9))


def test_a_model_alone_gives_the_label_map_of_its_surfaces(surfaces: Preop, model: DvfModel) -> None:
    ours, theirs = label_map_of_model(model), label_map(surfaces)
    assert np.array_equal(ours.grid.origin_mm, theirs.grid.origin_mm)
    assert np.mean(ours.values != theirs.values) < 1e-5  # vertices rounded to 32-bit floats
    assert np.array_equal(ours.timing.fractions, theirs.timing.fractions)


def test_a_model_alone_gives_the_heart_of_the_surfaces_it_was_built_from(
    surfaces: Preop, model: DvfModel
) -> None:
    alone, full = build_heart(Preop("ball"), model), build_heart(surfaces, model)
    assert alone.surface is not None
    assert full.surface is not None
    np.testing.assert_allclose(alone.surface.coefficients, full.surface.coefficients, atol=0.2)
    assert alone.beats_update_pose == full.beats_update_pose


def test_mr_gives_the_grey_levels_and_the_model_the_boundary(model: DvfModel) -> None:
    mr = mr_at(0.0)
    heart = build_heart(Preop("ball", mr=mr), model)
    assert heart.surface is not None
    assert np.array_equal(heart.channels.fractions, mr.timing.fractions)
    assert np.array_equal(heart.surface.fractions, model.timing.fractions)
    assert heart.beats_update_pose


def test_mr_that_does_not_show_the_heart_is_refused(model: DvfModel) -> None:
    with pytest.raises(InvalidInputError, match="lies outside the 4-D MR; give the MR of the examination"):
        build_heart(Preop("ball", mr=mr_at(80.0)), model)


@pytest.mark.parametrize("mr", [None, mr_at(0.0)], ids=["alone", "with MR"])
def test_without_chambers_it_says_what_is_lacking_and_goes_on(
    model: DvfModel, mr: VolumeSeries | None, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, logger="dvf_ig"):
        heart = build_heart(Preop("ball", mr=mr), replace(model, chambers=()))
    assert heart.surface is None
    assert np.isfinite(heart.channels.values).all()
    assert len(caplog.records) == 1
    assert "holds no chamber of blood" in caplog.text
    assert "--cavity" in caplog.text


def test_another_patient_s_model_is_refused_and_the_way_out_named(model: DvfModel) -> None:
    with pytest.raises(InvalidInputError, match=r"of patient 'ball', needed patient 'P-3'.*--patient 'ball'"):
        build_heart(Preop("P-3"), model)
