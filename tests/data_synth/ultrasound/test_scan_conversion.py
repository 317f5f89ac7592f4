"""Scan conversion: geometry by closed form, exactness on linear fields, refusals."""

import numpy as np
import pytest

from data_synth.ultrasound.presets import PROBES
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.scan_conversion import PixelGrid, PolarGrid, ScanConverter
from dvf_ig.core import InvalidInputError

POLAR = PolarGrid(65, 200, 20.0, 100.0, 0.6)
PIXELS = PixelGrid(240, 260, (0.5, 0.5), (129.5, -30.0))


def test_angle_and_radius_are_reproduced() -> None:
    """Grey linear in angle, or in radius, is interpolated without error up to rounding to whole levels."""
    convert = ScanConverter.of(POLAR, PIXELS)
    row, column = np.mgrid[: PIXELS.rows, : PIXELS.columns]
    x, y = (column - 129.5) * 0.5, (row + 30.0) * 0.5
    radius, angle = np.hypot(x, y), np.arctan2(x, y)
    inside = (radius >= 20) & (radius <= 100) & (np.abs(angle) <= 0.6)
    by_angle = np.repeat(np.linspace(0, 250, 65)[:, None], 200, axis=1).astype(np.float32)
    shown = convert(by_angle)
    assert np.abs(shown[inside] - (angle[inside] + 0.6) / 1.2 * 250).max() < 0.51
    assert not shown[~inside].any()
    by_depth = np.repeat((2.5 * (np.arange(200) + 0.5) * 0.4)[None], 65, axis=0).astype(np.float32)
    well = inside & (radius > 20.2) & (radius < 99.8)
    assert np.abs(convert(by_depth)[well] - 2.5 * (radius[well] - 20)).max() < 0.51


def test_apex_may_lie_outside_the_image() -> None:
    image = ScanConverter.of(POLAR, PIXELS)(np.full((65, 200), 255, dtype=np.float32))
    top = np.flatnonzero(image[:, 130].any() and image[:, 130])
    assert top[0] == pytest.approx(20.0 / 0.5 - 30.0, abs=1)
    assert top[-1] == pytest.approx(100.0 / 0.5 - 30.0, abs=1)


@pytest.mark.parametrize("name", ["epicardial", "apical", "tee", "curvilinear", "ice"])
def test_the_stated_fan_is_what_is_insonified(name: str) -> None:
    probe = PROBES[name]
    assert isinstance(probe, SectorProbe)
    line, _ = probe.pixel_lookup()
    disagree = (line >= 0) != probe.fan.mask(probe.rows, probe.columns)
    assert disagree.sum() <= 2  # rounding on the rim


@pytest.mark.parametrize("name", ["epicardial", "apical", "tee", "curvilinear", "ice"])
def test_the_sector_fits_its_image(name: str) -> None:
    probe = PROBES[name]
    assert isinstance(probe, SectorProbe)
    line, _ = probe.pixel_lookup()
    shown_mm2 = (line >= 0).sum() * (probe.mm_per_px[0] * probe.mm_per_px[1])
    whole_mm2 = probe.half_angle_rad * (probe.polar.stop_mm**2 - probe.polar.start_mm**2)
    assert shown_mm2 == pytest.approx(whole_mm2, rel=0.01)


def test_impossible_geometry_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="start < stop"):
        PolarGrid(64, 100, 50.0, 40.0, 0.5)
    with pytest.raises(InvalidInputError, match="needed 2 each"):
        PolarGrid(1, 100, 0.0, 40.0, 0.5)
