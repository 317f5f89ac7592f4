"""Pose streams, hand motion and the probe's path."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.operator.hand import reframed, tremor
from data_synth.operator.probe_path import (
    STANDOFF_MM,
    HeartOutline,
    SweepSpec,
    acoustic_window,
    central_view,
    replayed_path,
    sweeping_path,
)
from data_synth.seeds import child_rng
from data_synth.signals.tracker import TrackerSpec, sampling_times, tracked
from dvf_ig.core import FloatArray, InvalidInputError, PoseStream, Rigid

WINDOW = np.array([0.5, -0.8, -0.3]) / np.linalg.norm([0.5, -0.8, -0.3])


def still(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.tile(np.eye(3), (len(t_s), 1, 1)), np.tile([10.0, 20.0, 30.0], (len(t_s), 1))


def measured(spec: TrackerSpec, seconds: float = 200.0, seed: int = 0) -> PoseStream:
    rng = np.random.default_rng(seed)
    true_s, stamp_s = sampling_times(spec, 0.0, seconds, rng)
    return tracked(still, "tracker", "tool", true_s, stamp_s, spec, rng)


def test_noise_has_the_stated_rms() -> None:
    stream = measured(TrackerSpec(rate_hz=100.0, position_mm=0.2, rotation_deg=0.1))
    error = stream.translations_mm - [10.0, 20.0, 30.0]
    assert np.sqrt((error**2).sum(axis=1).mean()) == pytest.approx(0.2, rel=0.03)
    turned = Rotation.from_matrix(stream.rotations).magnitude()
    assert np.degrees(np.sqrt((turned**2).mean())) == pytest.approx(0.1, rel=0.03)


def test_times_are_irregular_as_stated_and_increase() -> None:
    spec = TrackerSpec(rate_hz=100.0, jitter_s=0.001, stamp_noise_s=0.0002)
    true_s, stamp_s = sampling_times(spec, 0.0, 200.0, np.random.default_rng(1))
    assert (np.diff(stamp_s) > 0).all()
    assert len(true_s) / 200.0 == pytest.approx(100.0)
    assert (true_s - np.arange(len(true_s)) / 100.0).std() == pytest.approx(0.001, rel=0.05)
    assert (stamp_s - true_s).std() == pytest.approx(0.0002, rel=0.05)


def test_dropouts_are_not_ok_and_hold_no_pose() -> None:
    spec = TrackerSpec(rate_hz=100.0, dropouts_per_min=12.0, dropout_s=(0.1, 0.2))
    stream = measured(spec, seconds=600.0)
    assert 1 - stream.valid.mean() == pytest.approx(12 * 0.15 / 60, rel=0.3)
    assert (stream.rotations[~stream.valid] == np.eye(3)).all()
    assert (stream.translations_mm[~stream.valid] == 0).all()


def test_a_late_tracker_stamps_its_poses_late() -> None:
    late = TrackerSpec(rate_hz=100.0, latency_s=0.03)
    true_s, stamp_s = sampling_times(late, 0.0, 20.0, np.random.default_rng(2))
    plain_s, plain_stamp_s = sampling_times(TrackerSpec(rate_hz=100.0), 0.0, 20.0, np.random.default_rng(2))
    np.testing.assert_array_equal(true_s, plain_s)
    np.testing.assert_allclose(stamp_s - plain_stamp_s, 0.03, atol=1.1e-6)


def test_stated_losses_are_lost_and_nothing_else() -> None:
    stream = measured(TrackerSpec(rate_hz=100.0, lost_s=((3.0, 5.5), (7.0, 7.2))), seconds=10.0)
    lost = ((stream.t_s > 3.0) & (stream.t_s < 5.5)) | ((stream.t_s > 7.0) & (stream.t_s < 7.2))
    edge = np.min(np.abs(stream.t_s[:, None] - [3.0, 5.5, 7.0, 7.2]), axis=1) < 0.002
    np.testing.assert_array_equal(stream.valid[~edge], ~lost[~edge])


@pytest.mark.parametrize(
    "changes", [{"rate_hz": 0.0}, {"position_mm": -1.0}, {"lost_s": ((2.0, 1.0),)}, {"latency_s": -0.1}]
)
def test_impossible_trackers_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError):
        TrackerSpec(**{"rate_hz": 10.0, **changes})


def test_reframing_composes_on_both_sides() -> None:
    left = Rigid.from_rotation_vector([0.3, -0.2, 0.9], [5.0, 6.0, 7.0], "mr", "tracker")
    right = Rigid.from_rotation_vector([-0.7, 0.1, 0.2], [1.0, -2.0, 3.0], "tool", "plane")
    rotations, translations = reframed(still, left, right)(np.array([0.0]))
    middle = Rigid("tracker", "tool", np.eye(3), [10.0, 20.0, 30.0])
    expected = (left @ middle @ right).matrix
    np.testing.assert_allclose(rotations[0], expected[:3, :3], atol=1e-12)
    np.testing.assert_allclose(translations[0], expected[:3, 3], atol=1e-12)


def test_tremor_has_its_size_and_band() -> None:
    t = np.arange(0, 200.0, 0.005)
    shake = tremor(np.random.default_rng(3))(t)
    assert np.sqrt((shake**2).sum(axis=1).mean()) == pytest.approx(0.05, rel=0.05)
    power = (np.abs(np.fft.rfft(shake[:, 0])) ** 2)[1:]
    frequency = np.fft.rfftfreq(len(t), 0.005)[1:]
    assert power[(frequency > 7.5) & (frequency < 12.5)].sum() > 0.99 * power.sum()


def egg() -> HeartOutline:
    direction = np.random.default_rng(4).standard_normal((3000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    center = np.array([10.0, 20.0, -30.0])
    return HeartOutline(center, center + direction * [50.0, 45.0, 60.0])


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_the_sweep_is_slow_near_and_sees_the_heart_from_many_sides(seed: int) -> None:
    outline = egg()
    path = sweeping_path(outline, WINDOW, SweepSpec(), np.random.default_rng(seed))
    t = np.arange(0.0, 60.0, 0.02)
    rotations, apex = path(t)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-9)
    nearest = np.linalg.norm(apex[::20, None] - outline.vertices_mm[None], axis=2).min(axis=1)
    assert nearest.min() > 30.0
    assert nearest.max() < 60.0
    smooth = apex.reshape(-1, 5, 3).mean(axis=1)
    speed = np.linalg.norm(np.diff(smooth, axis=0), axis=1) / 0.1
    assert speed.max() < 32.0
    assert 4.0 < np.median(speed) < 20.0
    depth = np.einsum("ij,ij->i", outline.center_mm - apex, rotations[:, :, 1])
    assert depth.min() > 60.0
    for start in range(0, 50, 10):
        part = (t >= start) & (t < start + 9.0)
        turned = Rotation.from_matrix(rotations[part]).as_rotvec()
        spread = np.degrees(np.ptp(turned - turned.mean(axis=0), axis=0))
        assert (spread > 12.0).all(), "each sweep turns about all three axes"
        assert (np.ptp(apex[part], axis=0) > 4.0).all(), "and moves along all three"


def test_the_window_avoids_what_blocks_sound() -> None:
    outline = egg()

    def blocked(xyz: FloatArray) -> FloatArray:
        return ((xyz - outline.center_mm)[:, 0] > 0).astype(np.float64)

    preferred = np.array([1.0, 0.0, 0.0])
    found = acoustic_window(blocked, outline, preferred)
    assert found[0] < -0.4
    np.testing.assert_allclose(np.linalg.norm(found), 1.0)
    free = acoustic_window(lambda xyz: np.zeros(len(xyz)), outline, preferred)
    assert free @ preferred > 0.97


def test_the_central_view_looks_at_the_heart() -> None:
    outline = egg()
    pose = central_view(outline, WINDOW)
    to_center = outline.center_mm - pose.translation_mm
    distance = np.linalg.norm(to_center)
    np.testing.assert_allclose(pose.rotation[:, 1], to_center / distance, atol=1e-9)
    assert distance > outline.radius_mm(WINDOW[None])[0] + STANDOFF_MM[0]


def recorded() -> PoseStream:
    t = 5.0 + np.arange(0.0, 12.0, 0.08)
    turns = Rotation.from_rotvec(np.column_stack([0.14 * t / 12, 0 * t, 0.3 + 0 * t]))
    shifts = np.column_stack([25.0 * t / 12, 3.0 * np.sin(t), 100.0 + 0 * t])
    valid = np.ones(len(t), dtype=np.bool_)
    valid[20] = False
    return PoseStream("reference", "probe", t, turns.as_matrix(), shifts, valid)


def test_a_replayed_path_is_centred_continuous_and_measured() -> None:
    poses = recorded()
    path = replayed_path(poses)
    ok = poses.valid
    ends = poses.translations_mm[ok]
    assert path.extent_mm == pytest.approx(
        max(np.linalg.norm(a - b) for a in ends[::3] for b in ends[::3]), rel=0.02
    )
    assert path.extent_deg == pytest.approx(np.degrees(0.14 * 11.92 / 12), rel=0.02)
    t = np.arange(0.0, 60.0, 0.005)
    rotations, shifts = path(t)
    assert np.linalg.norm(np.diff(shifts, axis=0), axis=1).max() < 0.05
    assert np.abs(path(poses.t_s[ok] - 5.0)[1].mean(axis=0)).max() < 1e-6
    length = float(path.t_s[-1])
    np.testing.assert_allclose(path(np.array([length + 1.0]))[1], path(np.array([length - 1.0]))[1])
    relative = Rotation.from_matrix(rotations).magnitude()
    assert np.degrees(relative.max()) < 8.0


def test_a_path_without_valid_poses_is_refused() -> None:
    poses = recorded()
    none = PoseStream(
        "reference", "probe", poses.t_s, poses.rotations, poses.translations_mm, np.zeros(len(poses), bool)
    )
    with pytest.raises(InvalidInputError, match="0 valid poses"):
        replayed_path(none)


def test_streams_are_independent_of_each_other() -> None:
    assert child_rng(1, "ecg").integers(2**40) == child_rng(1, "ecg").integers(2**40)
    assert child_rng(1, "ecg").integers(2**40) != child_rng(1, "tool").integers(2**40)
    assert child_rng(1, "ecg").integers(2**40) != child_rng(2, "ecg").integers(2**40)
