"""The predicted tool tip: exact for steady motion, unknown when stale, lost or frozen, causal."""

from collections.abc import Iterable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, Points
from dvf_ig.guidance import Hazard
from dvf_ig.session import ToolPose
from dvf_ig.session.tool_tracker import FROZEN_POSES, ToolReading, ToolTracker

TIP = Points("tool", np.array([[10.0, 0.0, 150.0]]))
TURN = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
VELOCITY = np.array([20.0, -10.0, 5.0])


def pose_at(t_s: float) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN, VELOCITY * t_s
    return matrix


def steady(seconds: float = 2.0) -> list[ToolPose]:
    """Translation at a steady velocity, 100 Hz."""
    return [ToolPose(t_s, pose_at(t_s)) for t_s in (np.arange(round(100 * seconds)) / 100).tolist()]


def read(poses: Iterable[ToolPose], times: FloatArray) -> list[ToolReading]:
    tracker = ToolTracker(TIP)
    for pose in poses:
        tracker.push(pose)
    return [tracker.at(t_s) for t_s in times.tolist()]


def test_steady_motion_is_predicted_exactly() -> None:
    times = np.arange(0.1, 1.9, 0.001)
    expected = TURN @ TIP.xyz_mm[0] + np.outer(times, VELOCITY)
    readings = read(steady(), times)
    assert not any(reading.hazard for reading in readings)
    np.testing.assert_allclose([r.tip_tracker_mm for r in readings], expected, atol=1e-9)
    assert max(r.age_s for r in readings) < 0.0101


def test_lost_tracking_is_bridged_for_two_and_a_half_frames_and_stale_poses_expire() -> None:
    poses = steady()
    poses[100:110] = [ToolPose(pose.t_s, None) for pose in poses[100:110]]
    times = np.arange(0.0, 2.2, 0.001)
    readings = read(poses, times)
    for t_s, reading in zip(times.tolist(), readings, strict=True):
        if 1.0155 <= t_s < 1.0995:
            assert reading.hazard is Hazard.TOOL_LOST
            assert not reading.tip_tracker_mm.any()
        if t_s > 1.99 + 0.0255:
            assert reading.hazard is Hazard.STALE_TOOL
        if 0.1 < t_s < 0.99:
            assert not reading.hazard


def test_a_pose_that_repeats_bit_by_bit_is_old_whatever_its_status_says() -> None:
    poses = steady()
    poses[100:] = [ToolPose(pose.t_s, poses[100].tracker_from_tool) for pose in poses[100:]]
    frozen_s = poses[100 + FROZEN_POSES - 1].t_s
    before, after = read(poses, np.array([frozen_s - 0.001, frozen_s]))
    assert not before.hazard
    assert after.hazard is Hazard.TOOL_FROZEN
    assert not after.tip_tracker_mm.any()


@pytest.mark.parametrize(
    ("matrix", "hazard"),
    [
        (np.full((4, 4), np.nan), Hazard.NOT_FINITE),
        (np.diag([1.01, 1.0, 1.0, 1.0]), Hazard.TOOL_LOST),
        (np.diag([1.0, 1.0, -1.0, 1.0]), Hazard.TOOL_LOST),
    ],
)
def test_what_is_no_rigid_pose_is_never_used(matrix: FloatArray, hazard: Hazard) -> None:
    poses = [*steady()[:50], ToolPose(0.5, matrix), ToolPose(0.51, matrix), ToolPose(0.52, matrix)]
    *_, first, _, later = read(poses, np.append(np.arange(0.001, 0.4995, 0.01), [0.501, 0.511, 0.5205]))
    assert later.hazard is hazard
    assert first.hazard is (hazard if hazard is Hazard.NOT_FINITE else Hazard.NONE)
    if not first.hazard:
        np.testing.assert_allclose(first.tip_tracker_mm, TURN @ TIP.xyz_mm[0] + 0.501 * VELOCITY, atol=1e-9)


def test_a_single_lost_frame_is_predicted_over() -> None:
    poses = steady()
    poses[60::25] = [ToolPose(pose.t_s, None) for pose in poses[60::25]]
    times = np.arange(0.1, 1.9, 0.001)
    readings = read(poses, times)
    assert not any(reading.hazard for reading in readings)
    expected = TURN @ TIP.xyz_mm[0] + np.outer(times, VELOCITY)
    np.testing.assert_allclose([r.tip_tracker_mm for r in readings], expected, atol=1e-9)


def test_a_clock_that_restarts_is_refused_and_small_disorder_is_dropped() -> None:
    jittered = steady()
    jittered[50], jittered[51] = jittered[51], jittered[50]
    assert not any(reading.hazard for reading in read(jittered, np.arange(0.1, 1.9, 0.01)))
    restarted = [*steady()[:150], *(ToolPose(p.t_s - 10.0, p.tracker_from_tool) for p in steady()[150:])]
    readings = read(restarted, np.array([1.495, 1.6, 1.99]))
    assert [reading.hazard for reading in readings] == [
        Hazard.NONE,
        Hazard.CLOCK_BACKWARDS,
        Hazard.CLOCK_BACKWARDS,
    ]


def test_later_poses_do_not_change_earlier_ticks() -> None:
    times = np.arange(0.0, 0.89, 0.001)
    whole, part = read(steady(), times), read(steady()[:90], times)
    for first, second in zip(whole, part, strict=True):
        assert first.hazard is second.hazard
        np.testing.assert_array_equal(first.tip_tracker_mm, second.tip_tracker_mm)


def test_poses_that_suddenly_come_late_are_noticed_where_the_tool_moves() -> None:
    def hazards(speed: float) -> set[Hazard]:
        tracker, found = ToolTracker(TIP), set()
        for i in range(300):
            matrix = pose_at(0.01 * i)
            matrix[:3, 3] *= speed
            tracker.push(ToolPose(0.01 * i, matrix))
            delay_s = 0.002 if i < 200 else 0.022
            found.add(tracker.at(0.01 * i + delay_s).hazard)
        return found

    assert hazards(2.0) == {Hazard.NONE, Hazard.LATENCY_JUMP}
    assert hazards(0.1) == {Hazard.NONE}


def between(apart_mm: float, noise_mm: float = 0.0, apart_s: float = 0.003) -> set[Hazard]:
    """Hazards while two programs send the tool, each at 100 Hz, `apart_mm` from each other."""
    tracker, found, rng = ToolTracker(TIP), set(), np.random.default_rng(2)
    for i in range(300):
        for t_s, off_mm in ((0.01 * i, 0.0), (0.01 * i + apart_s, apart_mm)):
            matrix = pose_at(t_s)
            matrix[:3, 3] += np.array([off_mm, 0.0, 0.0]) + rng.normal(0.0, noise_mm, 3)
            tracker.push(ToolPose(t_s, matrix))
            found.add(tracker.at(t_s).hazard)
    return found


@pytest.mark.parametrize("apart_s", [0.0001, 0.003, 0.009])
def test_two_tools_in_one_stream_contradict_each_other(apart_s: float) -> None:
    assert Hazard.TOOL_CONTRADICTED in between(5.0, apart_s=apart_s)
    assert Hazard.TOOL_CONTRADICTED in between(300.0, apart_s=apart_s)


def test_a_noisy_tracker_and_a_single_wrong_pose_contradict_nothing() -> None:
    assert between(0.0, noise_mm=0.5) <= {Hazard.NONE}
    poses = steady()
    wrong = pose_at(1.0)
    wrong[0, 3] += 40.0
    poses[100] = ToolPose(1.0, wrong)
    assert not any(reading.hazard for reading in read(poses, np.arange(0.1, 1.9, 0.01)))


@pytest.mark.parametrize("rate_hz", [6.0, 12.0, 25.0])
def test_the_velocity_of_a_slow_tracker_is_finite(rate_hz: float) -> None:
    """Frames further apart than twice the span of the difference: at 12 Hz it was 0/0."""
    poses = [ToolPose(t_s, pose_at(t_s)) for t_s in (np.arange(60) / rate_hz).tolist()]
    for number in range(5, 60):
        (reading,) = read(poses[:number], np.array([poses[number - 1].t_s + 0.001]))
        assert reading.hazard is Hazard.NONE
        assert np.isfinite(reading.velocity_mm_s).all()
        assert np.isfinite(reading.tip_tracker_mm).all()


def test_a_device_at_rest_repeats_its_pose_and_is_not_frozen() -> None:
    at_rest = [ToolPose(pose.t_s, pose_at(0.0), by_encoders=True) for pose in steady()]
    readings = read(at_rest, np.arange(0.5, 1.5, 0.01))
    assert all(reading.hazard is Hazard.NONE for reading in readings)
    assert all(not reading.velocity_mm_s.any() for reading in readings)
