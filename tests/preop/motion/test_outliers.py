"""Frames that cannot be right are found by themselves, sound ones are left alone."""

import numpy as np
import pytest
from short_axis_toy import CAVITY, contracting_stack

from dvf_ig.core import Volume, VolumeSeries
from dvf_ig.preop import dice, propagate_labels, track_cycle
from dvf_ig.preop.motion.outliers import Reason

PHASES, SPOILT = 12, 4
SCALES = tuple(0.89 + 0.11 * np.cos(2 * np.pi * np.arange(PHASES) / PHASES))


@pytest.fixture(scope="module")
def stack():
    return contracting_stack(SCALES)


def spoilt(image, kind):
    values = image.values.copy()
    if kind == "shifted":
        values[SPOILT] = np.roll(values[SPOILT], 6, axis=0)
    elif kind == "noise":
        values[SPOILT] = np.random.default_rng(3).normal(size=values[SPOILT].shape)
    return VolumeSeries(image.grid, values, image.timing)


@pytest.mark.parametrize("kind", ["sound", "shifted", "noise"])
def test_only_a_frame_that_cannot_be_right_is_replaced(stack, kind):
    image, labels = stack
    given = spoilt(image, kind)
    motion = track_cycle(given, labels[0] > 0)
    assert [r.phase for r in motion.replaced] == ([] if kind == "sound" else [SPOILT])
    known = Volume(image.grid, labels[0])
    moved = propagate_labels(motion, given, known, SPOILT)
    truth = labels[SPOILT] == CAVITY
    assert dice(moved == CAVITY, truth) > 0.93 > dice(labels[0] == CAVITY, truth)
    if kind == "shifted":
        assert motion.replaced[0].reason is Reason.JUMP
        assert motion.replaced[0].jump_mm > 3.0
