"""Beyond the ends of a stack: chambers that long-axis views show, and what of them is known."""

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, FloatArray, FrameMismatchError, Grid, VolumeSeries
from dvf_ig.preop import beyond_stack
from dvf_ig.preop.surface.beyond_stack import ASIDE_MM, KNOWN_MM, ExtendedLabels

STACK = Grid.axis_aligned("mr", (25, 25, 10), np.zeros(3), 2.0)
"""A slab from 0 to 18 mm along z, about a ventricle on the line (24, 24)."""
VIEW = Grid(
    "mr",
    (50, 90, 1),
    np.array([0.0, 24.0, -40.0]),
    np.array([1.0, 1.0, 8.0]),
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
)
"""A view in the plane y = 24: x along its first axis, z from −40 to 49 mm along its second."""
SHOWN = np.ones((4, *STACK.shape), dtype=np.bool_)
BLOOD, WALL, AROUND = 800.0, 300.0, 350.0


def labels() -> VolumeSeries:
    """A ventricle of 8 mm radius in a wall of 4 mm, at four phases."""
    radius = np.linalg.norm(STACK.centers_mm()[..., :2] - 24.0, axis=-1)
    codes = np.where(radius < 8.0, 2, np.where(radius < 12.0, 1, 0)).astype(np.uint8)
    return VolumeSeries(STACK, np.stack([codes] * 4), CycleTiming.uniform(4, 0.9))


def atrium(at_mm: FloatArray, phase: int) -> FloatArray:
    """Depth within an atrium 4 mm above the stack, 3 mm smaller in the second phase of the view."""
    size = 10.0 - 3.0 * phase
    return np.asarray(size - np.linalg.norm(at_mm - [24.0, 24.0, 32.0], axis=-1))


def view(grid: Grid = VIEW, shift_mm: FloatArray | None = None) -> VolumeSeries:
    """Two phases: the ventricle, an atrium, a line of fat above it, and a vessel far from the heart."""
    at = grid.centers_mm() - (0.0 if shift_mm is None else shift_mm)
    x, z = at[..., 0], at[..., 2]
    phases = []
    for phase in (0, 1):
        ventricle = (np.abs(x - 24.0) < 8.0) & (np.abs(z - 5.0) < 16.0)
        fat = np.abs(z - 46.0) < 1.5
        grey = np.where((np.abs(x - 24.0) < 12.0) & (z < 21.0), WALL, AROUND)
        phases.append(np.where(ventricle | fat | (atrium(at, phase) > 0.0), BLOOD, grey))
    noise = np.random.default_rng(1).normal(0.0, 20.0, (2, *grid.shape))
    return VolumeSeries(grid, (np.stack(phases) + noise).astype(np.float32), CycleTiming.uniform(2, 0.9))


def extended(one: VolumeSeries, shift_mm: FloatArray | None = None) -> ExtendedLabels:
    shifts = np.zeros((1, 3)) if shift_mm is None else shift_mm[None]
    found = beyond_stack(labels(), SHOWN, [one], shifts)
    assert found is not None
    return found


def dice(found: ExtendedLabels, phase: int) -> float:
    """Overlap of the atrium in the view's plane."""
    at = found.labels.grid.centers_mm()
    plane = found.known & (np.abs(at[..., 1] - 24.0) < 1.0) & (at[..., 2] > 20.0)
    ours, true = found.labels.values[phase][plane] == 2, atrium(at[plane], phase // 2) > 0.0
    return float(2.0 * (ours & true).sum() / (ours.sum() + true.sum()))


def test_an_atrium_is_labelled_at_every_phase_and_fat_is_not() -> None:
    found = extended(view())
    # the nearest of the view's two phases: 0, and 1/2
    assert dice(found, 0) > 0.9
    assert dice(found, 2) > 0.9
    at = found.labels.grid.centers_mm()
    wall = found.labels.values[0] == 1
    above = found.known & (at[..., 2] > 20.0)
    assert wall[above].any()
    assert (np.abs(atrium(at[wall & above & (np.abs(at[..., 1] - 24.0) < 1.0)], 0)) < 5.0).all()
    assert not (found.labels.values[:, above & (at[..., 2] > 45.0)] == 2).any()


def test_it_is_known_near_the_view_beside_the_heart_and_the_stack_keeps_its_labels() -> None:
    found = extended(view())
    at = found.labels.grid.centers_mm()
    inner = (at[..., 2] > -0.5) & (at[..., 2] < 18.5)
    assert found.known[inner].all()
    np.testing.assert_array_equal(found.labels.values[:, inner].ravel(), labels().values.ravel())
    beyond = found.known & ~inner
    assert beyond.any()
    assert (np.abs(at[beyond][:, 1] - 24.0) <= KNOWN_MM).all()
    assert (np.linalg.norm(at[beyond][:, :2] - 24.0, axis=1) <= 12.0 + ASIDE_MM).all()


def test_a_view_of_another_breath_hold_is_put_back() -> None:
    shift = np.array([3.0, 0.0, 4.0])
    assert dice(extended(view(shift_mm=shift), shift), 0) > 0.9
    assert dice(extended(view(shift_mm=shift)), 0) < 0.85


def test_views_that_miss_the_heart_add_nothing_and_another_frame_is_refused() -> None:
    away = Grid(
        "mr", VIEW.shape, VIEW.origin_mm + np.array([0.0, 90.0, 0.0]), VIEW.spacing_mm, VIEW.direction
    )
    assert beyond_stack(labels(), SHOWN, [view(away)], np.zeros((1, 3))) is None
    ct = Grid("ct", VIEW.shape, VIEW.origin_mm, VIEW.spacing_mm, VIEW.direction)
    with pytest.raises(FrameMismatchError, match="long-axis view"):
        beyond_stack(labels(), SHOWN, [view(ct)], np.zeros((1, 3)))


def test_what_follows_the_base_into_the_stack_is_taken_from_the_view() -> None:
    shown = SHOWN.copy()
    shown[2, :, :, 7:] = False  # above 13 mm, in one phase
    found = beyond_stack(labels(), shown, [view()], np.zeros((1, 3)))
    assert found is not None
    at = found.labels.grid.centers_mm()
    plane = (np.abs(at[..., 1] - 24.0) < 1.0) & (at[..., 2] > 13.0) & (at[..., 2] < 18.5)
    ventricle = np.abs(at[plane][:, 0] - 24.0)
    # the view's own outline of what is a ventricle there, and its wall of atria around it
    assert (found.labels.values[2, plane][ventricle < 6.0] == 2).all()
    assert (found.labels.values[2, plane][ventricle > 12.0] == 0).all()
    np.testing.assert_array_equal(found.labels.values[0, plane], extended(view()).labels.values[0, plane])
    assert found.known[plane & (np.abs(at[..., 0] - 24.0) < 10.0)].all()
    away = (np.abs(at[..., 1] - 24.0) > KNOWN_MM) & (at[..., 2] > 13.0)
    assert not found.known[away].any()
