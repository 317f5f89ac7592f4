"""Pose and phase: equivariance, refusals, and the tick that a servo loop calls."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import FrameMismatchError, InvalidInputError, Rigid
from dvf_ig.guidance import Evaluator, PoseAndPhase, Sigmoid, Status

vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
POSE = Rigid.from_rotation_vector([0.4, -1.1, 0.7], [30.0, -80.0, 12.0], "mr", "tracker")


@given(turn=vectors, shift=vectors)
def test_the_force_turns_with_the_frame_it_is_asked_in(ball, shell_points, turn, shift):
    pose = Rigid.from_rotation_vector(turn, 40 * np.array(shift), "mr", "tracker")
    phi = np.linspace(0, 1, len(shell_points))
    evaluator = Evaluator(ball, Sigmoid())
    direct = evaluator.force(shell_points, phi)
    tip = pose.inverse().apply_array(shell_points)
    through = PoseAndPhase(pose).evaluate(evaluator, tip, phi, np.ones(len(tip), dtype=bool))
    np.testing.assert_allclose(through.force_n @ pose.rotation.T, direct.force_n, atol=1e-9)
    np.testing.assert_allclose(through.gradient @ pose.rotation.T, direct.gradient, atol=1e-9)
    np.testing.assert_allclose(through.distance_mm, direct.distance_mm, atol=1e-9)


@pytest.mark.parametrize("shape", ["(3, 3)", "(4, 4)", "(n, 3, 3)", "(n, 4, 4)"])
def test_force_in_the_device_s_frame_is_a_free_vector(ball, shell_points, shape):
    device = Rigid.from_rotation_vector([0.2, 0.9, -0.3], [500.0, 0.0, -100.0], "tracker", "device")
    given_map = device.rotation if "3, 3" in shape else device.matrix
    if "n" in shape:
        given_map = np.broadcast_to(given_map, (len(shell_points), *given_map.shape))
    args = (Evaluator(ball, Sigmoid()), POSE.inverse().apply_array(shell_points), 0.4)
    valid = np.ones(len(shell_points), dtype=bool)
    in_tracker = PoseAndPhase(POSE).evaluate(*args, valid)
    in_device = PoseAndPhase(POSE).evaluate(*args, valid, given_map)
    np.testing.assert_allclose(in_device.force_n, in_tracker.force_n @ device.rotation, atol=1e-12)
    np.testing.assert_allclose(in_device.gradient, in_tracker.gradient @ device.rotation, atol=1e-12)
    assert np.array_equal(in_device.distance_mm, in_tracker.distance_mm)
    frames = (args[0].force(shell_points, 0.4).frame, in_tracker.frame, in_device.frame)
    assert frames == ("mr", "tracker", "device")


def test_no_force_unless_the_state_is_valid(ball, shell_points):
    tip = POSE.inverse().apply_array(shell_points)
    valid = np.arange(len(tip)) % 3 == 0
    tip[~valid] = np.nan
    phi = np.where(valid, 0.2, np.nan)
    samples = PoseAndPhase(POSE).evaluate(Evaluator(ball, Sigmoid()), tip, phi, valid)
    assert (samples.status[valid] == Status.OK).all()
    assert (samples.status[~valid] == Status.NO_PHASE).all()
    assert not samples.force_n[~valid].any()
    assert (np.linalg.norm(samples.force_n[valid], axis=1) > 0).all()


def test_the_reason_for_a_refusal_is_kept(ball, shell_points):
    tip = POSE.inverse().apply_array(shell_points)[:3]
    evaluator, valid = Evaluator(ball, Sigmoid()), np.array([True, False, False])
    reasons = np.array([Status.OK, Status.STALE_TOOL, Status.NO_POSE])
    samples = PoseAndPhase(POSE).evaluate(evaluator, tip, 0.2, valid, refusal=reasons)
    assert samples.status.tolist() == [Status.OK, Status.STALE_TOOL, Status.NO_POSE]
    with pytest.raises(InvalidInputError, match="give the reason"):
        PoseAndPhase(POSE).evaluate(evaluator, tip, 0.2, valid, refusal=np.zeros(3, dtype=int))


def test_an_unknown_device_orientation_is_a_fault(ball, shell_points):
    tip = POSE.inverse().apply_array(shell_points)[:3]
    device = np.tile(np.eye(3), (3, 1, 1))
    device[1] = np.nan
    device[2] = np.nan
    valid = np.array([True, True, False])
    samples = PoseAndPhase(POSE).evaluate(Evaluator(ball, Sigmoid()), tip, 0.2, valid, device)
    assert samples.status.tolist() == [Status.OK, Status.FAULT, Status.NO_PHASE]
    assert not samples.force_n[1:].any()


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
def test_the_bound_tick_is_the_batch(ball, shell_points, blend):
    tip = POSE.inverse().apply_array(shell_points)
    evaluator = Evaluator(ball, Sigmoid(), blend=blend)
    batch = PoseAndPhase(POSE).evaluate(evaluator, tip, 0.7, np.ones(len(tip), dtype=bool))
    tick = PoseAndPhase(POSE).bind(evaluator)
    out = np.empty(8)
    for k in range(0, len(tip), 17):
        assert tick(tip[k], 0.7, int(Status.OK), out) == Status.OK
        assert np.array_equal(out[:3], batch.force_n[k])
        assert out[3] == batch.distance_mm[k]
        assert np.array_equal(out[4:7], batch.gradient[k])
        assert out[7] == batch.rate_mm_per_cycle[k]


def test_the_bound_tick_leaves_what_it_was_not_given(ball):
    """Seven numbers are enough for who does not ask for the rate."""
    buffer = np.full(9, -1.0)
    tick = PoseAndPhase(POSE).bind(Evaluator(ball, Sigmoid()))
    tip = POSE.inverse().apply_array(np.array([0.0, 0.0, 14.0]))
    assert tick(tip, 0.1, int(Status.OK), buffer[:7]) == Status.OK
    assert buffer[7:].tolist() == [-1.0, -1.0]


@pytest.mark.parametrize("refusal", [s for s in Status if s is not Status.OK])
def test_the_bound_tick_passes_a_refusal_on(ball, refusal):
    out = np.ones(7)
    tick = PoseAndPhase(POSE).bind(Evaluator(ball, Sigmoid()))
    assert tick(POSE.inverse().apply_array(np.array([0.0, 0.0, 14.0])), 0.1, int(refusal), out) == refusal
    assert not out[:3].any()
    assert np.isnan(out[3:]).all()


def test_a_model_of_another_frame_is_refused(ball):
    elsewhere = PoseAndPhase(Rigid.identity("ct", "tracker"))
    with pytest.raises(FrameMismatchError, match=r"'ct'.*'mr'"):
        elsewhere.evaluate(Evaluator(ball, Sigmoid()), np.zeros((1, 3)), 0.1, np.ones(1, dtype=bool))
    with pytest.raises(FrameMismatchError):
        elsewhere.bind(Evaluator(ball, Sigmoid()))


def test_device_maps_of_other_shapes_are_refused(ball):
    with pytest.raises(InvalidInputError, match=r"tracker_from_device has shape \(2, 3, 3\)"):
        PoseAndPhase(POSE).evaluate(
            Evaluator(ball, Sigmoid()), np.zeros((3, 3)), 0.1, np.ones(3, dtype=bool), np.zeros((2, 3, 3))
        )
