"""A tracked tool in a session's servo: predicted between poses, without steps, never far ahead; its ticks."""

import numpy as np
import pytest

from dvf_ig.core import FloatArray
from dvf_ig.guidance import Fixtures, FixtureSet, Hazard, Status, SupervisorState
from dvf_ig.guidance.servo import TrackedServo
from dvf_ig.guidance.servo.inputs import VALID_FOR_S
from dvf_ig.kernels.servo.tracked import FARTHEST_MM, LONGEST_S, SMOOTHED_S, TRACKED, publish_tip, tip_at

INSIDE = np.array([9.0, 0.0, 0.0])
STILL = np.zeros(3)


class Tool:
    """The kernel's record of a tool."""

    def __init__(self) -> None:
        self.record = np.zeros(1, TRACKED)[0]
        self.jumped = False

    def publish(self, tip_mm: FloatArray, velocity_mm_s: FloatArray, t_s: float) -> None:
        publish_tip(self.record, tip_mm, velocity_mm_s, t_s)

    def at(self, t_s: float) -> FloatArray:
        out = np.empty(3)
        self.jumped = tip_at(self.record, t_s, out)
        return out


def moving(t_s: float, x_mm: float = 0.0) -> Tool:
    tool = Tool()
    tool.publish(np.array([x_mm, 2.0, 3.0]), np.array([20.0, 0.0, -10.0]), t_s)
    return tool


def test_tip_moves_on_between_poses() -> None:
    tool = moving(5.0)
    np.testing.assert_allclose(tool.at(5.0), [0.0, 2.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(tool.at(5.01), [0.2, 2.0, 2.9], atol=1e-9)


def test_tip_is_predicted_no_further_than_its_poses_are_good_for() -> None:
    np.testing.assert_allclose(moving(5.0).at(9.0), [20.0 * LONGEST_S, 2.0, 3.0 - 10.0 * LONGEST_S])


def test_new_pose_is_gone_over_to_without_a_step() -> None:
    tool = moving(5.0)
    before = tool.at(5.010)
    tool.publish(np.array([0.7, 2.0, 2.9]), np.array([20.0, 0.0, -10.0]), 5.010)
    at = tool.at(5.011)
    assert not tool.jumped
    assert np.linalg.norm(at - before) < 0.025 + 0.5 / SMOOTHED_S * 1e-3
    steps = [tool.at(5.011 + k * 1e-3) for k in range(1, 40)]
    assert max(np.linalg.norm(b - a) for a, b in zip([at, *steps], steps, strict=False)) < 0.13
    np.testing.assert_allclose(steps[-1], [0.7 + 20.0 * 0.040, 2.0, 2.9 - 10.0 * 0.040], atol=1e-3)


def test_pose_that_is_far_off_counts_at_once() -> None:
    tool = moving(5.0)
    tool.at(5.0)
    tool.publish(np.array([2.0 * FARTHEST_MM, 2.0, 3.0]), np.zeros(3), 5.01)
    np.testing.assert_allclose(tool.at(5.01), [2.0 * FARTHEST_MM, 2.0, 3.0], atol=1e-6)
    assert tool.jumped


@pytest.mark.parametrize("t_s", [0.5, 7.0])
def test_before_the_first_pose_it_is_at_the_origin(t_s: float) -> None:
    np.testing.assert_array_equal(Tool().at(t_s), np.zeros(3))


def run(servo, transform, times, tip_mm=INSIDE):
    margin = np.zeros(1)
    return [servo.step(t, transform, Hazard.NONE, Status.OK, margin, (tip_mm, STILL)) for t in times]


def test_ticks_between_states_are_those_of_states_a_period_apart(ball, steady_ball) -> None:
    """A state every 10 ms gives the force of one every ms: the servo ticks meanwhile."""
    coarse = run(TrackedServo(Fixtures(ball, FixtureSet())), steady_ball, np.arange(60) * 0.010)
    fine = run(TrackedServo(Fixtures(ball, FixtureSet())), steady_ball, np.arange(591) * 0.001)
    for k, one in enumerate(coarse):
        np.testing.assert_allclose(one.sent_n, fine[10 * k].sent_n, atol=1e-9)
        assert one.state == fine[10 * k].state
    assert coarse[-1].state is SupervisorState.OK
    assert np.linalg.norm(coarse[-1].sent_n) > 0.1


def test_a_session_that_publishes_nothing_is_silent_and_latches_after_a_second(ball, steady_ball) -> None:
    for gap_s, state in ((0.5 * VALID_FOR_S, SupervisorState.OK), (1.2, SupervisorState.LATCHED)):
        servo = TrackedServo(Fixtures(ball, FixtureSet()))
        before = run(servo, steady_ball, np.arange(400) * 0.001)[-1]
        after = run(servo, steady_ball, [0.399 + gap_s])[0]
        assert before.state is SupervisorState.OK
        assert after.state is state
        assert after.sent_n.any() == (state is SupervisorState.OK)


def test_a_tip_that_jumps_does_no_work_on_the_hand(ball, steady_ball) -> None:
    """Out of the wall in one pose: the energy observer starts again, and nothing latches."""
    servo = TrackedServo(Fixtures(ball, FixtureSet()))
    run(servo, steady_ball, np.arange(400) * 0.001)
    far = run(servo, steady_ball, 0.4 + np.arange(300) * 0.001, np.array([-40.0, 0.0, 0.0]))
    assert not any(tick.hazards & Hazard.ENERGY for tick in far)
    assert {tick.state for tick in far} <= {
        SupervisorState.OK,
        SupervisorState.FADE,
        SupervisorState.DEGRADED,
    }
