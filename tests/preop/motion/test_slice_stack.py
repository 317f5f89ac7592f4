"""Stacks of short-axis slices: what their header says, and where they end within the heart."""

from dataclasses import replace

import numpy as np
import pytest
from short_axis_toy import CAVITY, WALL, contracting_stack

from dvf_ig.core import Grid, InvalidInputError, Volume, VolumeSeries
from dvf_ig.preop import DisplacementField, assess_motion, dice, propagate_labels, track_cycle
from dvf_ig.preop.cine_model import _chamber
from dvf_ig.preop.motion.open_ends import FAR_MM, seen_part
from dvf_ig.preop.motion.slice_stack import axis_of_lost_spacing, observable_axes

END_SYSTOLE = 3


@pytest.fixture(scope="module")
def stack():
    return contracting_stack()


def without_spacing(image: VolumeSeries) -> VolumeSeries:
    """As cines come whose header says 1 mm along every axis."""
    return VolumeSeries(
        Grid.axis_aligned("mr", image.grid.shape, np.zeros(3), 1.0), image.values, image.timing
    )


@pytest.mark.parametrize(
    ("missing", "heights_mm"),
    [
        ([], [[-43.5, 0.5]]),
        ([4], [[-33.5 - FAR_MM, 0.5]]),
        ([2], [[-43.5, -29.5], [-13.5, 0.5]]),
        ([2, 4], [[-33.5 - FAR_MM, -29.5], [-13.5, 0.5]]),
    ],
)
def test_what_slices_show_ends_where_they_or_their_labels_end(stack, missing, heights_mm):
    """The base up to slice 0; the apex beyond slice 4, unless a slice shows that nothing is there."""
    image, labels = stack
    organ = labels[0] > 0
    organ[:, :, missing] = False
    shift = np.zeros((5, 3))
    shift[:, 2] = -1.5
    found = seen_part(image.grid, organ, shift, 6)
    np.testing.assert_allclose(found.normal, [0.0, 0.0, -1.0])
    # slice k shows the heart at z = 10 k + 1.5 and 2 mm on either side; the base is at z = 0, heights are −z
    np.testing.assert_allclose(found.bounds_mm, np.tile(heights_mm, (6, 1, 1)))
    cube = Grid.axis_aligned("mr", (4, 4, 4), np.zeros(3), 1.5)
    assert seen_part(cube, np.ones((4, 4, 4), dtype=np.bool_), None, 6) is None


@pytest.mark.parametrize("lost", [False, True])
def test_labels_follow_a_stack_whatever_its_header_says(stack, lost):
    """Motion across the slices would fit anything, and bring labels in from beyond the ends."""
    image, labels = stack
    image = without_spacing(image) if lost else image
    motion = track_cycle(image, labels[0] > 0)
    assert motion.observable.tolist() == [True, True, False]
    assert motion.spacing_lost is lost
    assert assess_motion(motion, image, labels[0] > 0).slice_pitch_mm == (1.0 if lost else 10.0)
    moved = propagate_labels(motion, image, Volume(image.grid, labels[0]), END_SYSTOLE)
    for k in range(image.grid.shape[2]):
        for value, least in ((WALL, 0.85), (CAVITY, 0.9)):  # outlines half a pixel off, at the apex
            there = labels[END_SYSTOLE, ..., k] == value
            assert dice(moved[..., k] == value, there) > least
            assert dice(moved[..., k] == value, there) > dice(labels[0, ..., k] == value, there) + 0.05


def test_the_slice_pitch_is_seen_in_the_grey_levels():
    image, _ = contracting_stack((1.0, 0.9), noise=0.1)
    apart = without_spacing(image).values[0]
    assert axis_of_lost_spacing(apart, np.ones(3)) == 2
    assert axis_of_lost_spacing(apart.transpose(2, 0, 1), np.ones(3)) == 0
    assert axis_of_lost_spacing(apart, image.grid.spacing_mm) is None
    rng = np.random.default_rng(2)
    assert axis_of_lost_spacing(rng.normal(size=(20, 20, 20)), np.ones(3)) is None
    assert observable_axes(np.array([1.5, 1.5, 2.9])).all()
    assert observable_axes(np.array([1.5, 1.5, 10.0])).tolist() == [True, True, False]


def test_a_chamber_of_which_a_stack_holds_the_end_is_left_out_with_a_warning(stack, caplog):
    image, labels = stack
    motion = track_cycle(image, labels[0] > 0)
    end = np.zeros(image.grid.shape, dtype=np.bool_)
    end[10, 10:12, -1] = True
    assert _chamber(motion, image, end, "left atrium", None) is None
    assert "too little of left atrium" in caplog.text
    close = Grid.axis_aligned("mr", image.grid.shape, np.zeros(3), 2.0)
    with pytest.raises(InvalidInputError, match="fewer than a surface needs"):
        _chamber(motion, VolumeSeries(close, image.values, image.timing), end, "left atrium", None)


def test_what_comes_in_through_the_end_of_the_stack_is_continued(stack):
    """Tissue that moves one slice towards the apex leaves none without a label behind."""
    image, labels = stack
    still = track_cycle(image, labels[0] > 0)
    down = np.zeros((*still.grid.shape, 3))
    down[..., 2] = 10.0
    field = DisplacementField(still.grid, down)
    moving = replace(still, deformations=(still.deformations[0], *[field] * 5))
    moved = propagate_labels(moving, image, Volume(image.grid, labels[0]), 2)
    assert np.array_equal(moved[..., 1:], labels[0][..., :-1])
    assert np.array_equal(moved[..., 0], labels[0][..., 0])
