"""The predicted tool tip: exact for steady motion, invalid when stale or lost, causal."""

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import PoseStream
from dvf_ig.replay.tool_tip import predict_tip

TIP_MM = np.array([10.0, 0.0, 150.0])


def steady(valid: np.ndarray | None = None) -> PoseStream:
    """Translation at (20, -10, 5) mm/s, 100 Hz for 2 s."""
    t = np.arange(200) / 100
    turn = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    ok = np.ones(200, dtype=bool) if valid is None else valid
    shifts = np.outer(t, [20.0, -10.0, 5.0])
    return PoseStream("tracker", "tool", t, np.tile(turn, (200, 1, 1)), shifts, ok)


def test_steady_motion_is_predicted_exactly() -> None:
    t = np.arange(0.1, 1.9, 0.001)
    track = predict_tip(steady(), TIP_MM, t)
    expected = steady().rotations[0] @ TIP_MM + np.outer(t, [20.0, -10.0, 5.0])
    assert track.valid.all()
    np.testing.assert_allclose(track.tip_tracker_mm, expected, atol=1e-9)


def test_lost_tracking_is_not_bridged_and_stale_poses_expire() -> None:
    valid = np.ones(200, dtype=bool)
    valid[100:110] = False
    track = predict_tip(steady(valid), TIP_MM, np.arange(0.0, 2.2, 0.001))
    lost = (track.t_s >= 1.0) & (track.t_s < 1.0995)
    assert not track.valid[lost].any()
    assert not track.tip_tracker_mm[lost].any()
    assert not track.valid[track.t_s > 1.99 + 0.0255].any()
    assert track.valid[(track.t_s > 0.1) & (track.t_s < 0.99)].all()


def test_later_poses_do_not_change_earlier_ticks() -> None:
    stream = steady()
    short = PoseStream(
        "tracker",
        "tool",
        stream.t_s[:90],
        stream.rotations[:90],
        stream.translations_mm[:90],
        stream.valid[:90],
    )
    t = np.arange(0.0, 0.89, 0.001)
    np.testing.assert_array_equal(
        predict_tip(stream, TIP_MM, t).tip_tracker_mm, predict_tip(short, TIP_MM, t).tip_tracker_mm
    )
