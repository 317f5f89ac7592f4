"""Shifts between breath-holds and the base's descent, recovered from images of a field known everywhere."""

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, FloatArray, Grid, VolumeSeries
from dvf_ig.preop import MotionOptions, slice_shifts
from dvf_ig.preop.motion.base_descent import base_descent
from dvf_ig.preop.motion.slice_phases import SlicePhases

PHASES = 8
MIDDLE_MM = np.array([40.0, 40.0, 35.0])
SHIFTS_MM = np.array(
    [
        [1.5, -0.5, 0.8],
        [-1.0, 1.2, -0.9],
        [0.3, 0.4, 0.2],
        [-1.6, -1.1, 0.7],
        [0.9, 1.4, -1.2],
        [-0.1, -1.4, 0.4],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
    ]
)
"""Of six short-axis slices and two long-axis views; their mean is none."""
DESCENT_MM = 9.0


def field(xyz_mm: FloatArray, phase: float) -> FloatArray:
    """A tapering tube of blood in muscle, whose top comes down by DESCENT_MM and whose foot stays."""
    x, y, z = np.moveaxis(xyz_mm - MIDDLE_MM, -1, 0)
    squeeze = 1.0 - DESCENT_MM / 60.0 * np.sin(np.pi * phase) ** 2
    height = (z + 35.0) / squeeze
    radius = np.hypot(x - 0.05 * height, y)
    wave = 0.2 * np.sin(0.5 * height) * np.cos(0.25 * x + 0.1 * height) * np.sin(0.3 * y + 1.0)
    inner = 12.0 + 0.12 * height
    return 0.3 + wave + 0.4 / (1 + np.exp((radius - inner) / 0.8)) + 0.2 / (1 + np.exp((radius - 32.0) / 0.8))


def series(grid: Grid, shifts_mm: FloatArray) -> VolumeSeries:
    """Every slice in its own breath-hold."""
    centers = grid.centers_mm()
    values = np.stack([field(centers - shifts_mm[None, None], i / PHASES) for i in range(PHASES)])
    noise = 0.01 * np.random.default_rng(3).standard_normal(values.shape)
    return VolumeSeries(grid, values + noise, CycleTiming.uniform(PHASES, 0.9))


def stack() -> VolumeSeries:
    spacing = np.array([1.5, 1.5, 10.0])
    return series(Grid.axis_aligned("mr", (54, 54, 6), [0.0, 0.0, 10.0], spacing), SHIFTS_MM[:6])


def views() -> tuple[VolumeSeries, ...]:
    z = np.array([0.0, 0.0, 1.0])
    found = []
    for k, across in enumerate(([1.0, 0.0, 0.0], [0.5, np.sqrt(0.75), 0.0])):
        axes = np.column_stack([across, z, np.cross(across, z)])
        corner = MIDDLE_MM - axes @ np.array([40.0, 38.0, 0.0])
        grid = Grid("mr", (54, 54, 1), corner, np.full(3, 1.5), axes)
        found.append(series(grid, SHIFTS_MM[6 + k : 7 + k]))
    return tuple(found)


def organ(image: VolumeSeries) -> np.ndarray:
    at = image.grid.centers_mm() - MIDDLE_MM
    return np.asarray(np.hypot(at[..., 0], at[..., 1]) < 22.0 + 0.08 * at[..., 2])


def test_shifts_are_found_along_the_intersections() -> None:
    image = stack()
    found = slice_shifts(image, organ(image), organ(image), views())
    wrong = found.sax_mm - SHIFTS_MM[:6]
    assert np.linalg.norm(SHIFTS_MM[:6, :2], axis=1).mean() > 1.2
    assert np.linalg.norm(wrong[:, :2], axis=1).max() < 0.6
    assert np.abs(wrong[:, 2]).max() < 1.0
    assert found.after > found.before
    assert found.sax_sigma_mm.max() < 1.0
    points = np.array([[30.0, 42.0, 30.0], [30.0, 42.0, 35.0]])
    expected = points - [found.sax_mm[2], 0.5 * (found.sax_mm[2] + found.sax_mm[3])]
    np.testing.assert_allclose(found.corrected(points), expected, atol=1e-9)


def test_without_views_nothing_is_known_through_the_slices() -> None:
    image = stack()
    found = slice_shifts(image, organ(image), organ(image), ())
    assert np.abs(found.sax_mm[:, 2]).max() < 1e-9
    assert found.sax_sigma_mm[:, 2] == pytest.approx(2.0)
    assert np.isnan(found.before)


def test_the_base_comes_down_as_the_views_show() -> None:
    image = stack()
    shown = views()
    shifts = slice_shifts(image, organ(image), organ(image), shown)
    since = image.timing.fractions
    course = np.sin(np.pi * since) ** 2
    phases = SlicePhases(since, course, 0.5, np.full(6, 0.5))
    base = base_descent(image, organ(image), None, 0, shown, shifts, phases, MotionOptions(threads=1))
    assert base is not None
    assert base.views == 2
    # the top slice lies 60 mm from the foot, where the field comes down by DESCENT_MM
    assert base.largest_mm == pytest.approx(DESCENT_MM, abs=1.5)
    assert base.base_mm[0] == pytest.approx(0.0, abs=0.3)
    assert int(base.base_mm.argmax()) == PHASES // 2
