"""A cavity whose wall is not labelled: the surface of its blood lies within the heart."""

import numpy as np
import pytest

from dvf_ig.core import BoolArray, CycleTiming, Grid, VolumeSeries
from dvf_ig.preop.surface.walls import RIGHT_WALL_MM, labels_with_walls, missing_walls, with_walls

PIXEL_MM = 0.5
X, Y = np.meshgrid(np.arange(120), np.arange(120), indexing="ij")


def disc(x: float, radius: float, slices: int = 3) -> BoolArray:
    return np.repeat((np.hypot(X - x, Y - 60) < radius)[:, :, None], slices, axis=2)


LEFT, MUSCLE = disc(40, 16), disc(40, 26)
RIGHT = disc(74, 24) & ~MUSCLE
"""A left ventricle with its wall, and the right one's blood against the septum."""
NAMES = ("lv_blood", "rv_blood")


def test_labelled_walls_are_left_alone() -> None:
    assert missing_walls(MUSCLE | disc(74, 32), (LEFT, RIGHT), NAMES) == ((), ())


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_wall_of_a_right_ventricle_is_added_and_told(order: tuple[int, int]) -> None:
    cavities, names = [(LEFT, RIGHT)[k] for k in order], [NAMES[k] for k in order]
    added, told = missing_walls(MUSCLE | RIGHT, cavities, names)
    assert [names[k] for k in added] == ["rv_blood"]
    assert len(told) == 1
    assert told[0].startswith("the wall of rv_blood is not labelled: 3 ± 1 mm are added")
    walled = with_walls(MUSCLE | RIGHT, [cavities[k] for k in added], np.array([PIXEL_MM, PIXEL_MM, 8.0]))
    wide = walled[:, 60, 1].sum() - (MUSCLE | RIGHT)[:, 60, 1].sum()
    assert wide * PIXEL_MM == pytest.approx(RIGHT_WALL_MM, abs=PIXEL_MM)
    assert (walled & disc(40, 26.0))[:40].sum() == MUSCLE[:40].sum()  # the left ventricle keeps its outline
    area = (walled & ~MUSCLE & ~RIGHT)[:, :, 0].sum() * PIXEL_MM**2
    bare = 2.0 * np.pi * 0.5 * (24 + 30) * PIXEL_MM  # outline halfway through the wall, all around
    assert 0.5 * bare < area / RIGHT_WALL_MM < 0.9 * bare


def test_a_wall_is_not_guessed_where_none_is_labelled() -> None:
    added, told = missing_walls(LEFT | RIGHT, (LEFT, RIGHT), NAMES)
    assert added == ()
    assert [sentence.split(":")[0] for sentence in told] == [
        "the wall of lv_blood is not labelled",
        "the wall of rv_blood is not labelled",
    ]


def test_a_cavity_outside_the_organ_needs_no_wall() -> None:
    """The left ventricle alone is guarded; the right one's blood is named for ultrasound."""
    assert missing_walls(MUSCLE, (LEFT, RIGHT), NAMES) == ((), ())


def test_the_wall_of_a_small_cavity_is_not_guessed() -> None:
    auricle = disc(74, 8)
    added, told = missing_walls(MUSCLE | auricle, (LEFT, auricle), ("lv_blood", "laa_blood"))
    assert added == ()
    assert len(told) == 1
    assert "there the surface of its blood is guarded" in told[0]


def test_the_ends_of_a_stack_are_no_missing_wall() -> None:
    """Blood reaches the basal slice, beyond which nothing is imaged."""
    cavity = np.zeros((20, 20, 3), dtype=np.bool_)
    cavity[6:14, 6:14, :2] = True
    organ = np.zeros_like(cavity)
    organ[4:16, 4:16, :] = True
    assert missing_walls(organ, (cavity,), ("lv_blood",)) == ((), ())


def test_every_phase_of_labels_gets_the_wall() -> None:
    grid = Grid.axis_aligned("mr", (*MUSCLE.shape,), np.zeros(3), [PIXEL_MM, PIXEL_MM, 8.0])
    values = np.zeros((2, *MUSCLE.shape), dtype=np.uint8)
    for phase, right in zip(values, (RIGHT, RIGHT & disc(74, 18)), strict=True):
        phase[MUSCLE], phase[LEFT], phase[right] = 2, 3, 1
    labels = VolumeSeries(grid, values, CycleTiming(np.array([0.0, 0.4]), 0.9))
    walled, organ, _ = labels_with_walls(labels, (1, 2, 3), (3, 1), NAMES)
    assert organ == (1, 2, 3, 4)
    for before, after in zip(values, walled.values, strict=True):
        np.testing.assert_array_equal(np.where(after == 4, 0, after), before)
        assert (after == 4).any(axis=(0, 1)).all()
