"""Motion of a pose: bounded speed, exact ends, and a velocity that is its derivative."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.core import (
    HEART_RADIUS_MM,
    UPDATE_MM_PER_S,
    FrameMismatchError,
    InvalidInputError,
    PoseMotion,
    Rigid,
    mean_displacement_mm,
)

CENTER_MM = np.array([20.0, -30.0, 100.0])
START = Rigid.from_rotation_vector([0.5, 0.2, -0.4], [300.0, -200.0, 500.0], "mr", "tracker")

small = st.floats(-0.1, 0.1)
shift = st.floats(-8.0, 8.0)


def test_mean_displacement_of_a_shift_and_of_a_turn() -> None:
    moved = START.perturbed_left([0, 0, 0], [3.0, 0.0, -4.0], CENTER_MM)
    assert mean_displacement_mm(START, moved, CENTER_MM) == pytest.approx(5.0)
    turned = START.perturbed_left([0, 0, 0.02], [0, 0, 0], CENTER_MM)  # four of the six points move
    assert mean_displacement_mm(START, turned, CENTER_MM) == pytest.approx(
        4 / 6 * 2 * HEART_RADIUS_MM * np.sin(0.01)
    )


@settings(max_examples=15)
@given(st.tuples(small, small, small), st.tuples(shift, shift, shift))
def test_a_new_pose_is_reached_at_a_bounded_speed(turn: tuple[float, ...], move: tuple[float, ...]) -> None:
    target = START.perturbed_left(turn, move, CENTER_MM)
    motion = PoseMotion.towards(START, target, 20.0, CENTER_MM)
    assert motion.at(19.0) is START
    assert motion.at(motion.end_s) is target
    t = np.arange(19.99, motion.end_s + 0.01, 0.005)
    poses = [motion.at(float(now)) for now in t]
    for first, following in itertools.pairwise(poses):
        assert mean_displacement_mm(first, following, CENTER_MM) <= 1.05 * UPDATE_MM_PER_S * 0.005 + 1e-9
    np.testing.assert_allclose(motion.matrices(t), [p.matrix[:3] for p in poses], atol=1e-12)
    nearly = motion.matrices(np.array([np.nextafter(motion.end_s, 0.0)]))[0]
    np.testing.assert_allclose(nearly, target.matrix[:3], atol=1e-9)


def test_half_way_the_heart_has_turned_by_half_about_its_centre() -> None:
    target = START.perturbed_left([0.0, 0.3, 0.0], [4.0, -2.0, 6.0], CENTER_MM)
    motion = PoseMotion.towards(START, target, 5.0, CENTER_MM, speed_mm_s=2.0)
    half = motion.at(0.5 * (5.0 + motion.end_s))
    expected = START.perturbed_left([0.0, 0.15, 0.0], [2.0, -1.0, 3.0], CENTER_MM)
    np.testing.assert_allclose(half.matrix, expected.matrix, atol=1e-9)
    assert motion.end_s - 5.0 == pytest.approx(mean_displacement_mm(START, target, CENTER_MM) / 2.0)


def test_velocity_is_the_derivative_of_place() -> None:
    target = START.perturbed_left([0.1, 0.3, -0.2], [4.0, -2.0, 6.0], CENTER_MM)
    motion = PoseMotion.towards(START, target, 5.0, CENTER_MM)
    t = np.concatenate([np.linspace(4.0, 4.99, 5), np.linspace(5.01, motion.end_s - 0.01, 20), [30.0]])
    tip = START.inverse().apply_array(CENTER_MM + np.array([25.0, 10.0, -30.0]))

    def place(at_s: np.ndarray) -> np.ndarray:
        matrices = motion.matrices(at_s)
        return np.asarray(matrices[:, :, :3] @ tip + matrices[:, :, 3])

    found = motion.velocity_mm_s(place(t), t)
    np.testing.assert_allclose(found, (place(t + 1e-5) - place(t - 1e-5)) / 2e-5, atol=1e-6)
    assert not found[:5].any()
    assert not found[-1].any()


def test_a_pose_that_stays() -> None:
    motion = PoseMotion.still(START)
    for t_s in (-np.inf, 0.0, 1e9):
        assert motion.at(t_s) is START
    t = np.array([0.0, 7.0])
    np.testing.assert_array_equal(motion.matrices(t), [START.matrix[:3]] * 2)
    assert not motion.velocity_mm_s(np.ones((2, 3)), t).any()
    same = PoseMotion.towards(START, START, 3.0, CENTER_MM)
    assert same.at(3.0) is START


def test_refusals() -> None:
    with pytest.raises(FrameMismatchError, match="'probe'"):
        PoseMotion.towards(START, Rigid.identity("mr", "probe"), 0.0, CENTER_MM)
    with pytest.raises(InvalidInputError, match="must be positive"):
        PoseMotion.towards(START, START, 0.0, CENTER_MM, speed_mm_s=0.0)
    with pytest.raises(InvalidInputError, match="in order"):
        PoseMotion(START, START, 2.0, 1.0, CENTER_MM, np.zeros(3), np.zeros(3))
