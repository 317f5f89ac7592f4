"""Clutter, shadows and a small dynamic range have the sizes that are stated."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.ultrasound.image_faults import CLUTTER_DB, CLUTTER_DECAY_MM, ImageSpec, degraded
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, InvalidInputError

PROBE = SectorProbe()
T_S = np.linspace(0.0, 50.0, 6)
GREY_PER_DB = 255.0 / PROBE.dynamic_range_db
FLOOR_DB = PROBE.top_db - PROBE.dynamic_range_db


def flat(level_db: float) -> FloatArray:
    """Images of one level inside the sector."""
    grey = np.uint8(np.clip((level_db - FLOOR_DB) * GREY_PER_DB, 0, 255))
    mask = PROBE.fan.mask(PROBE.rows, PROBE.columns)
    return np.tile(np.where(mask, grey, np.uint8(0)), (len(T_S), 1, 1))


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_without_faults_the_images_are_untouched() -> None:
    images = flat(0.0)
    out: object = degraded(images, PROBE, T_S, ImageSpec(), rng())
    assert out is images


def depth_mm() -> FloatArray:
    row, column = np.mgrid[: PROBE.rows, : PROBE.columns]
    offset = np.stack([column - PROBE.apex_px[0], row - PROBE.apex_px[1]])
    return np.asarray(np.hypot(*offset) * PROBE.mm_per_px[1])


@pytest.mark.parametrize("factor", [1.0, 5.0])
def test_clutter_has_its_level_and_its_decay(factor: float) -> None:
    wide = replace(PROBE, dynamic_range_db=100.0)
    dark = np.zeros_like(flat(0.0))
    out = degraded(dark, wide, T_S, ImageSpec(clutter=factor, dynamic_range_db=100.0), rng())
    mask, depth = PROBE.fan.mask(PROBE.rows, PROBE.columns), depth_mm()
    for near, far in ((20.0, 40.0), (80.0, 100.0)):
        ring = mask & (depth > near) & (depth < far)
        power = 10 ** ((out[:, ring] / 2.55 + wide.top_db - 100.0) / 10)
        expected = (
            CLUTTER_DB + 20 * np.log10(factor) - 20 * np.log10(np.e) * 0.5 * (near + far) / CLUTTER_DECAY_MM
        )
        # six frames of some 400 speckle cells, mixed from two fields
        assert 10 * np.log10(power.mean()) == pytest.approx(expected, abs=0.7)


def test_a_shadow_takes_its_loss_in_its_middle_and_leaves_the_rest() -> None:
    images = flat(5.0)
    out = degraded(images, PROBE, T_S, ImageSpec(shadows=1, shadow_db=20.0), rng())
    row = round(PROBE.apex_px[1] + 100.0 / PROBE.mm_per_px[1])
    inside = images[0, row] > 0
    lost_db = (images[:, row][:, inside].astype(float) - out[:, row][:, inside]) / GREY_PER_DB
    np.testing.assert_allclose(lost_db.max(axis=1), 20.0, atol=0.6)
    assert (lost_db < 1.0).mean() > 0.5
    assert np.ptp(lost_db.argmax(axis=1)) > 2, "it wanders"
    assert (out[images == 0] == 0).all()


def test_a_smaller_dynamic_range_drops_what_is_faint_and_keeps_white() -> None:
    spec = ImageSpec(dynamic_range_db=30.0)
    mask = PROBE.fan.mask(PROBE.rows, PROBE.columns)
    for level, expected in ((PROBE.top_db, 255.0), (PROBE.top_db - 15.0, 127.5), (PROBE.top_db - 35.0, 0.0)):
        out = degraded(flat(level), PROBE, T_S, spec, rng())
        assert np.median(out[:, mask]) == pytest.approx(expected, abs=2.0)


def test_impossible_faults_are_refused() -> None:
    with pytest.raises(InvalidInputError):
        ImageSpec(clutter=-1.0)
    with pytest.raises(InvalidInputError):
        ImageSpec(dynamic_range_db=5.0)
