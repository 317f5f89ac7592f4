"""Blood that comes into the slices of a stack after end-diastole."""

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, FloatArray, FrameMismatchError, Grid, VolumeSeries
from dvf_ig.preop import with_blood_that_enters

STACK = Grid("mr", (40, 40, 4), np.zeros(3), np.array([1.5, 1.5, 10.0]), np.eye(3))
"""Slices at z = 0, 10, 20, and 30 mm about a ventricle on the line (30, 30)."""
LABELS = Grid.axis_aligned("mr", (30, 30, 16), np.zeros(3), 2.0)
BLOOD, WALL, LUNG = 800.0, 300.0, 100.0
TIMING = CycleTiming.uniform(2, 0.9)


def radius_mm(grid: Grid) -> FloatArray:
    return np.asarray(np.linalg.norm(grid.centers_mm()[..., :2] - 30.0, axis=-1))


def labels() -> VolumeSeries:
    """A ventricle of 10 mm radius that contracts to 6 mm, in a wall that ends at 18 mm."""
    radius = radius_mm(LABELS)
    codes = [np.where(radius < inner, 2, np.where(radius < 18.0, 1, 0)) for inner in (10.0, 6.0)]
    return VolumeSeries(LABELS, np.stack(codes).astype(np.uint8), TIMING)


def stack(grid: Grid = STACK) -> VolumeSeries:
    """At end-systole the atrium fills the upper slice; a muscle stands in the blood, and fat around all."""
    radius, x, y, z = radius_mm(grid), *np.moveaxis(grid.centers_mm(), -1, 0)
    phases = []
    for phase, inner in enumerate((10.0, 6.0)):
        blood = radius < np.where((z > 25.0) & (phase == 1), 14.0, inner)
        thin = (np.abs(radius - 12.0) < 1.0) & (z < 5.0)
        muscle = np.hypot(x - 30.0, y - 27.0) < 2.5
        fat = (radius > 18.0) & (radius < 24.0)
        grey = np.where((blood & ~muscle) | fat | thin, BLOOD, np.where(radius < 18.0, WALL, LUNG))
        phases.append(grey)
    noise = np.random.default_rng(1).normal(0.0, 20.0, (2, *grid.shape))
    return VolumeSeries(grid, (np.stack(phases) + noise).astype(np.float32), TIMING)


def test_what_is_bright_and_thick_within_the_heart_becomes_blood() -> None:
    before, after = labels(), with_blood_that_enters(labels(), stack())
    radius, z = radius_mm(LABELS), LABELS.centers_mm()[..., 2]
    entered = (after.values[1] == 2) & (before.values[1] != 2)
    assert entered[(z == 30.0) & (radius > 8.0) & (radius < 12.0)].mean() > 0.95
    assert not entered[(z < 18.0) | (radius > 15.0)].any()
    unchanged = ~entered
    np.testing.assert_array_equal(after.values[1][unchanged], before.values[1][unchanged])
    np.testing.assert_array_equal(after.values[0], before.values[0])


def test_slices_that_do_not_tell_blood_from_wall_change_nothing() -> None:
    wall_alone = VolumeSeries(LABELS, np.minimum(labels().values, 1), TIMING)
    np.testing.assert_array_equal(with_blood_that_enters(wall_alone, stack()).values, wall_alone.values)


def test_labels_of_another_frame_are_refused() -> None:
    other = Grid("ct", STACK.shape, STACK.origin_mm, STACK.spacing_mm, STACK.direction)
    with pytest.raises(FrameMismatchError):
        with_blood_that_enters(labels(), stack(other))
