"""A tool is bright where the image meets it, for as long as the beam is thick, and hides what lies behind."""

import numpy as np
import pytest
from numpy.typing import NDArray

from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.tool_echo import ToolEchoSpec, with_tool
from dvf_ig.core import BoolArray, FloatArray, InvalidInputError

PROBE = SectorProbe()
SPEC = ToolEchoSpec(shown=True, glint_db=0.0)
GREY = 120
ACROSS, UPWARDS = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def nothing_hides(_: int, points: FloatArray) -> BoolArray:
    return np.zeros(len(points), dtype=np.bool_)


def shown(tip_mm: tuple[float, float, float], shaft: FloatArray) -> NDArray[np.uint8]:
    line, _ = PROBE.pixel_lookup()
    images = np.where(line >= 0, GREY, 0).astype(np.uint8)[None]
    rng = np.random.default_rng(0)
    return with_tool(images, PROBE, np.array([tip_mm]), shaft[None], nothing_hides, SPEC, rng)[0]


def pixel(x_mm: float, y_mm: float) -> tuple[int, int]:
    column = PROBE.apex_px[0] + x_mm / PROBE.mm_per_px[0]
    row = PROBE.apex_px[1] + y_mm / PROBE.mm_per_px[1]
    return round(row), round(column)


def test_a_shaft_in_the_image_is_a_line_that_ends_at_the_tip() -> None:
    image = shown((0.0, 80.0, 0.0), ACROSS)
    assert image[pixel(10.0, 80.0)] > GREY + 60
    assert image[pixel(2.0, 80.0)] > GREY + 60
    assert image[pixel(-8.0, 80.0)] == pytest.approx(GREY, abs=2)


def test_a_shaft_across_the_image_is_a_spot() -> None:
    image = shown((0.0, 80.0, 0.0), UPWARDS).astype(np.float64)
    row, column = np.unravel_index(image.argmax(), image.shape)
    assert np.hypot(row - pixel(0.0, 80.0)[0], column - pixel(0.0, 80.0)[1]) <= 4
    assert image[pixel(6.0, 80.0)] == pytest.approx(GREY, abs=4)


def test_a_tool_beside_the_image_is_not_shown() -> None:
    np.testing.assert_array_equal(shown((0.0, 80.0, 25.0), UPWARDS), shown((500.0, 80.0, 0.0), ACROSS))


def test_it_hides_what_lies_behind() -> None:
    image = shown((-20.0, 80.0, 0.0), ACROSS)
    assert image[pixel(0.0, 120.0)] < GREY - 40
    assert image[pixel(0.0, 60.0)] == pytest.approx(GREY, abs=2)


def test_what_lung_hides_is_not_shown() -> None:
    line, _ = PROBE.pixel_lookup()
    images = np.where(line >= 0, GREY, 0).astype(np.uint8)[None]
    rng = np.random.default_rng(0)

    def all_hidden(_: int, points: FloatArray) -> BoolArray:
        return np.ones(len(points), dtype=np.bool_)

    out = with_tool(images, PROBE, np.array([[0.0, 80.0, 0.0]]), ACROSS[None], all_hidden, SPEC, rng)
    np.testing.assert_array_equal(out, images)


def test_values_that_cannot_be_are_refused() -> None:
    with pytest.raises(InvalidInputError):
        ToolEchoSpec(shadow_db=-1.0)
