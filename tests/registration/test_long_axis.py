"""Long-axis views beyond the ends of a stack: what LC2 compares there, and what of it is known."""

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, FrameMismatchError, Grid, VolumeSeries
from dvf_ig.registration import CoveredPart, ModelChannels, with_long_axis_views
from dvf_ig.registration.long_axis import BESIDE_MM, BEYOND_MM

STACK = Grid.axis_aligned("mr", (20, 20, 10), np.zeros(3), 2.0)
"""Slab from 0 to 18 mm along z; the heart in it lies within 6 mm of (20, 20)."""
FRACTIONS = np.array([0.0, 0.25, 0.5, 0.75])
TALL = Grid(
    "mr",
    (40, 80, 1),
    np.array([0.0, 20.0, -60.0]),
    np.array([1.0, 2.0, 8.0]),
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
)
"""A view in the plane y = 20: columns along x, rows along z from −60 to 98 mm, 8 mm thick."""


def view(grid: Grid = TALL) -> VolumeSeries:
    """Grey levels that rise with z, by 100 from phase to phase; half as many phases as the channels."""
    z = grid.centers_mm()[..., 2]
    return VolumeSeries(grid, np.stack([z, z + 100.0]).astype(np.float32), CycleTiming.uniform(2, 0.9))


def stack() -> tuple[ModelChannels, CoveredPart]:
    values = np.random.default_rng(3).normal(size=(4, *STACK.shape, 2)).astype(np.float32)
    near = np.linalg.norm(STACK.centers_mm()[..., :2] - 20.0, axis=-1) <= 6.0
    return ModelChannels(STACK, values, FRACTIONS), CoveredPart(STACK, near, np.zeros((1, 3)))


def test_views_are_compared_beyond_the_stack_within_their_thickness_beside_the_heart() -> None:
    channels, part = stack()
    longer, known = with_long_axis_views(channels, part, [view()], np.zeros((1, 3)), smoothing_mm=1.0)
    at = known.grid.centers_mm()
    within = (at[..., 2] > -0.5) & (at[..., 2] < 18.5)
    assert np.array_equal(known.compared_voxels[within], part.compared_voxels.ravel())
    np.testing.assert_array_equal(longer.values[:, within].reshape(channels.values.shape), channels.values)
    assert at[..., 2].min() <= -BEYOND_MM
    assert at[..., 2].max() >= 18.0 + BEYOND_MM
    beside = np.linalg.norm(at[..., :2] - 20.0, axis=-1) <= 6.0 + BESIDE_MM
    slab = np.abs(at[..., 1] - 20.0) <= 4.0
    beyond = known.compared_voxels & ~within
    assert beyond.any()
    assert not (beyond & ~(slab & beside)).any()
    assert (beyond | within | ~(slab & (np.linalg.norm(at[..., :2] - 20.0, axis=-1) <= 6.0))).all()
    assert known.views
    assert not part.views


def test_grey_levels_are_those_of_the_nearest_phase_where_the_heart_lay_in_the_view() -> None:
    z = TALL.centers_mm()[..., 2]
    edges = VolumeSeries(TALL, np.stack([z > 40.0, z > 50.0]).astype(np.float32), CycleTiming.uniform(2, 0.9))
    shift = np.array([[0.0, 0.0, 6.0]])
    longer, known = with_long_axis_views(*stack(), [edges], shift, smoothing_mm=1.0)
    height = known.grid.centers_mm()[..., 2]
    row = known.compared_voxels & (height > 20.0) & (height < 70.0)
    z_of = [float(height[row][np.argmax(np.abs(longer.values[i, row, 1]))]) for i in range(4)]
    # the channels' phases 0, 1/4, 1/2, 3/4 meet the view's 0 and 1/2; the heart lay 6 mm higher in the view
    assert z_of[0] == pytest.approx(34.0, abs=2.0)
    assert z_of[2] == pytest.approx(44.0, abs=2.0)
    for i in (1, 3):
        assert min(abs(z_of[i] - z_of[0]), abs(z_of[i] - z_of[2])) == 0.0
    bright = longer.values[0, row, 0]
    assert bright[height[row] > 38.0].min() > bright[height[row] < 30.0].max()


def test_a_view_beside_the_heart_adds_nothing_and_another_frame_is_refused() -> None:
    channels, part = stack()
    away = Grid(
        "mr", TALL.shape, TALL.origin_mm + np.array([0.0, 200.0, 0.0]), TALL.spacing_mm, TALL.direction
    )
    _, known = with_long_axis_views(channels, part, [view(away)], np.zeros((1, 3)), smoothing_mm=1.0)
    assert not known.views
    assert known.compared_voxels.sum() == part.compared_voxels.sum()
    ct = Grid("ct", TALL.shape, TALL.origin_mm, TALL.spacing_mm, TALL.direction)
    with pytest.raises(FrameMismatchError, match="long-axis view"):
        with_long_axis_views(channels, part, [view(ct)], np.zeros((1, 3)), smoothing_mm=1.0)
