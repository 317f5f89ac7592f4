"""A registration update moves the model at a bounded speed and ends exactly at the new pose."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.core import Rigid
from dvf_ig.registration import mean_displacement_mm
from dvf_ig.replay.schedule import STEP_S, UPDATE_MM_PER_S, pose_schedule, suspended_at

CENTER_MM = np.array([20.0, -30.0, 100.0])
START = Rigid.from_rotation_vector([0.5, 0.2, -0.4], [300.0, -200.0, 500.0], "mr", "tracker")

small = st.floats(-0.1, 0.1)
shift = st.floats(-8.0, 8.0)


@settings(max_examples=15)
@given(st.tuples(small, small, small), st.tuples(shift, shift, shift), st.floats(0.05, 3.0))
def test_updates_are_bounded_and_arrive(
    turn: tuple[float, ...], move: tuple[float, ...], gap_s: float
) -> None:
    second = START.perturbed_left(turn, move, CENTER_MM)
    poses = pose_schedule([(10.0, START), (20.0, second), (20.0 + gap_s, START)], CENTER_MM)
    times = np.array([start_s for start_s, _ in poses])
    assert (np.diff(times) > 0).all()
    for (_, first), (_, following) in itertools.pairwise(poses):
        moved = mean_displacement_mm(first, following, CENTER_MM)
        assert moved <= 1.05 * UPDATE_MM_PER_S * STEP_S
    assert poses[-1][1] is START


def test_the_first_pose_is_used_at_once() -> None:
    assert pose_schedule([(3.0, START)], CENTER_MM) == ((3.0, START),)
    assert pose_schedule([], CENTER_MM) == ()


def test_after_a_suspension_a_pose_is_in_use_at_once() -> None:
    moved = START.perturbed_left([0.0, 0.0, 0.0], [8.0, 0.0, 0.0], CENTER_MM)
    updates = [(3.0, START), (10.0, None), (15.0, moved)]
    assert pose_schedule(updates, CENTER_MM) == ((3.0, START), (15.0, moved))
    ticks = np.array([2.9, 3.0, 9.9, 10.0, 14.9, 15.0])
    np.testing.assert_array_equal(suspended_at(updates, ticks), [True, False, False, True, True, False])
    assert suspended_at([], ticks).all()


def test_a_suspension_stops_a_motion_under_way() -> None:
    moved = START.perturbed_left([0.0, 0.0, 0.0], [8.0, 0.0, 0.0], CENTER_MM)
    poses = pose_schedule([(3.0, START), (10.0, moved), (10.1, None)], CENTER_MM)
    assert max(start_s for start_s, _ in poses) < 10.1
    assert mean_displacement_mm(poses[-1][1], START, CENTER_MM) < 1.05
