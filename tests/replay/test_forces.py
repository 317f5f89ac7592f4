"""Force at each tick: only from a pose in use, a valid phase and a tracked tool, each as they were then."""

import numpy as np
import pytest

from dvf_ig.core import BoolArray, DvfModel, FloatArray, Rigid
from dvf_ig.guidance import Evaluator, Fixtures, ForceSamples, Sigmoid, Status
from dvf_ig.replay.forces import force_samples
from dvf_ig.replay.tool_tip import TipTrack

T_S = np.arange(8) / 1000.0
TIP_MM = np.tile([14.0, 3.0, -2.0], (8, 1))
"""Near the surface of the ball, where every phase pushes."""
PHASE = np.linspace(0.1, 0.5, 8)
FIRST = Rigid.identity("mr", "tracker")
SECOND = Rigid.from_rotation_vector([0.0, 0.0, 0.3], [1.0, -2.0, 0.5], "mr", "tracker")


def forces(
    ball: DvfModel, suspended: BoolArray, tracked: BoolArray, phase_valid: BoolArray
) -> tuple[ForceSamples, BoolArray]:
    tip = TipTrack(T_S, TIP_MM, tracked)
    poses = ((0.0, FIRST), (0.004, SECOND))
    return force_samples(Fixtures(ball), poses, suspended, tip, PHASE, phase_valid)


def expected_n(ball: DvfModel, pose: Rigid, tick: int) -> FloatArray:
    """Into the model's frame, the evaluator there, and the force back into the tracker's."""
    there = Evaluator(ball, Sigmoid()).force(pose.apply_array(TIP_MM[tick])[None], PHASE[tick : tick + 1])
    return np.asarray(there.force_n[0] @ pose.rotation)


def test_each_tick_goes_through_the_pose_then_in_use(ball: DvfModel) -> None:
    no, yes = np.zeros(8, dtype=bool), np.ones(8, dtype=bool)
    samples, valid = forces(ball, no, yes, yes)
    assert valid.all()
    assert np.linalg.norm(samples.force_n, axis=1).min() > 0.1
    for tick in range(8):
        pose = FIRST if tick < 4 else SECOND
        np.testing.assert_allclose(samples.force_n[tick], expected_n(ball, pose, tick), atol=1e-12)


@pytest.mark.parametrize(
    ("missing", "reason"),
    [("pose", Status.NO_POSE), ("phase", Status.NO_PHASE), ("tool", Status.STALE_TOOL)],
)
def test_whatever_is_missing_there_is_no_force_and_its_name(
    ball: DvfModel, missing: str, reason: Status
) -> None:
    some = np.array([False, True, True, False, False, True, False, True])
    yes = np.ones(8, dtype=bool)
    samples, valid = forces(
        ball,
        suspended=some if missing == "pose" else ~yes,
        tracked=~some if missing == "tool" else yes,
        phase_valid=~some if missing == "phase" else yes,
    )
    np.testing.assert_array_equal(valid, ~some)
    assert (samples.force_n[some] == 0).all()
    assert (samples.status[some] == reason).all()
    assert (samples.status[~some] == Status.OK).all()


def test_a_suspended_pose_is_named_before_anything_else(ball: DvfModel) -> None:
    yes = np.ones(8, dtype=bool)
    samples, valid = forces(ball, suspended=yes, tracked=~yes, phase_valid=~yes)
    assert not valid.any()
    assert (samples.status == Status.NO_POSE).all()
