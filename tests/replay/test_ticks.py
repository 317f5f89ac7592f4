"""What is recorded of a session is what it said."""

import numpy as np
import pytest
from toy_session import GUIDED_S, compare_known, register_known, run, ticks, toy_setup, toy_streams

from dvf_ig.guidance import Status
from dvf_ig.replay.ticks import TickRecorder, Ticks
from dvf_ig.session import GuidanceState, Session, ToolPose

TIMES = ticks(10.5, 18.0)


@pytest.fixture(scope="module")
def said() -> tuple[list[GuidanceState], Ticks]:
    """A registration, a pose that moves, a tool that is lost, images that fail."""
    streams = toy_streams(
        18.0, patient=lambda t_s: np.array([0, 0, 0, 0.5 * min(2.0, max(0.0, t_s - 11.5)), 0, 0])
    )
    streams.tool = [ToolPose(p.t_s, None) if 12.8 <= p.t_s < 13.0 else p for p in streams.tool]
    streams.frames = [f for f in streams.frames if f.t_s < 14.0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvf_ig.session.arrived_ultrasound.register_frames", register_known)
        patch.setattr("dvf_ig.session.arrived_ultrasound.compare_beat", compare_known)
        with Session(toy_setup()) as session:
            states = run(session, streams.merged(), TIMES)
    recorder = TickRecorder(np.array(TIMES))
    for i, state in enumerate(states):
        recorder.add(i, state)
    return states, recorder.finish()


def test_every_number_is_the_states(said: tuple[list[GuidanceState], Ticks]) -> None:
    states, rows = said
    assert len(rows) == len(states)
    np.testing.assert_array_equal(rows.t_s, TIMES)
    for name in (
        "force_n",
        "wanted_n",
        "model_phase",
        "distance_mm",
        "pose_age_s",
        "pose_bound_mm",
        "status",
        "supervisor",
    ):
        np.testing.assert_array_equal(getattr(rows, name), [getattr(s, name) for s in states])
    np.testing.assert_array_equal(rows.hazards, [int(s.supervised.hazards) for s in states])
    np.testing.assert_array_equal(rows.valid, [s.status is Status.OK for s in states])
    assert 0.2 < rows.valid.mean() < 0.9
    phases = [s.phase for s in states]
    np.testing.assert_array_equal(rows.phase.phi, [p.phi for p in phases])
    np.testing.assert_array_equal(rows.phase.sigma_phi, [p.sigma_phi for p in phases])
    np.testing.assert_array_equal(rows.phase.state, [p.state for p in phases])


def test_the_tip_is_nan_where_the_tool_is_not_known(said: tuple[list[GuidanceState], Ticks]) -> None:
    states, rows = said
    known = np.array([not s.tool.hazard for s in states])
    assert not known.all()
    assert np.isnan(rows.tip_tracker_mm[~known]).all()
    np.testing.assert_array_equal(
        rows.tip_tracker_mm[known], [s.tool.tip_tracker_mm for s in states if not s.tool.hazard]
    )


def test_the_pose_is_the_one_in_use_then_and_nan_while_it_is_withheld(
    said: tuple[list[GuidanceState], Ticks],
) -> None:
    states, rows = said
    for state, matrix in zip(states, rows.mr_from_tracker, strict=True):
        motion = state.transform.pose
        if motion is None or state.now_s >= state.transform.pose_until_s:
            assert np.isnan(matrix).all()
        else:
            np.testing.assert_allclose(matrix, motion.at(state.now_s).matrix[:3], atol=1e-12)
    withheld = np.isnan(rows.mr_from_tracker[:, 0, 0])
    assert withheld[0]
    assert withheld[-1]
    assert not withheld[[t_s > GUIDED_S and t_s < 14.0 for t_s in TIMES]].any()
    assert not rows.wanted_n[withheld].any()
