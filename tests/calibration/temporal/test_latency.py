"""Lag between tracker and video: known lags, the alias, refusals, PLUS's real water tank."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_synth.phantoms.watertank import watertank_recording
from data_synth.scenario.ground_truth import draw_ground_truth
from data_synth.scenario.presets import Preset
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.calibration import Gate, accepted, estimate_latency, wall_trace
from dvf_ig.core import FloatArray, LatencyRecording, NoOverlapError, PoseStream, QualityGateError, Trace
from dvf_ig.io import read_latency_recording, read_sequence


def depth_mm(t_s: FloatArray, wander: float) -> FloatArray:
    """Up and down about once a second; `wander` bends the pace so that no two periods are alike."""
    return np.asarray(12.0 * np.sin(2 * np.pi * (t_s / 1.03 + wander * np.sin(0.9 * t_s))))


def recording(
    lag_s: float, *, wander: float = 0.2, noise_mm: float = 0.05, noise_px: float = 1.0, sign: float = 1.0,
    video_s: float = 17.0, amplitude: float = 1.0,
) -> LatencyRecording:  # fmt: skip
    """Tracker at 46 Hz along an oblique axis, video at 11.7 Hz: t_tracker = t_video + lag."""
    rng = np.random.default_rng(0)
    tracker_t = np.arange(-2.0, video_s + 2.0, 1 / 46.0)
    axis = np.array([0.3, -0.8, 0.52])
    moved = amplitude * np.outer(depth_mm(tracker_t, wander), axis / np.linalg.norm(axis))
    moved += noise_mm * rng.standard_normal(moved.shape)
    turns = np.tile(np.eye(3), (len(tracker_t), 1, 1))
    poses = PoseStream("tracker", "probe", tracker_t, turns, moved, np.ones(len(tracker_t), bool))
    video_t = np.arange(0.0, video_s, 1 / 11.7)
    rows = 300 + sign * amplitude * depth_mm(video_t + lag_s, wander) / 0.078
    return LatencyRecording(poses, Trace(video_t, rows + noise_px * rng.standard_normal(len(rows))))


@settings(max_examples=15)
@given(st.floats(-0.3, 0.3), st.sampled_from([1.0, -1.0]))
def test_known_lags_of_both_signs(lag_s: float, sign: float) -> None:
    found = estimate_latency(recording(lag_s, sign=sign))
    # 1 px of 154 px amplitude at 200 frames: 0.1 ms; linear interpolation at 46 Hz adds as much
    assert found.lag_s == pytest.approx(lag_s, abs=0.001)
    assert found.interval_s[0] <= found.lag_s <= found.interval_s[1]
    assert found.correlation > 0.99


def test_the_half_period_alias_of_the_other_sign_is_not_taken() -> None:
    found = estimate_latency(recording(-0.065, wander=0.12))
    assert found.lag_s == pytest.approx(-0.065, abs=0.001)
    assert found.second_lag_s == pytest.approx(0.45, abs=0.05), "the alias exists and was weighed"
    assert found.second_peak_ratio < 0.985


def test_a_perfect_sine_cannot_be_told_from_its_alias() -> None:
    with pytest.raises(QualityGateError, match="two lags fit equally well"):
        accepted(estimate_latency(recording(-0.065, wander=0.0)))
    found = estimate_latency(recording(-0.065, wander=0.0))
    assert [why.gate for why in found.refusals] == [Gate.SECOND_ANSWER]
    either = np.abs(np.array([found.lag_s, found.second_lag_s]) + 0.065)
    assert either.min() < 0.005


def test_refusals() -> None:
    with pytest.raises(QualityGateError, match="no motion to compare"):
        accepted(estimate_latency(recording(0.0, amplitude=0.01)))
    with pytest.raises(QualityGateError, match="up-and-down movements"):
        accepted(estimate_latency(recording(0.0, video_s=2.2)))
    with pytest.raises(QualityGateError, match="correlation"):
        accepted(estimate_latency(recording(0.0, noise_px=400.0)))
    moved = recording(0.0)
    later = Trace(moved.wall_row_px.t_s + 1000.0, moved.wall_row_px.values)
    with pytest.raises(NoOverlapError, match="0 valid poses while the video ran"):
        estimate_latency(LatencyRecording(moved.tracker_from_probe, later))


def test_lost_tracking_is_not_interpolated_over() -> None:
    whole = recording(0.05)
    poses = whole.tracker_from_probe
    valid = poses.valid.copy()
    valid[(poses.t_s > 5.0) & (poses.t_s < 6.5)] = False
    shifts = poses.translations_mm.copy()
    shifts[~valid] = 1e4
    cut = PoseStream("tracker", "probe", poses.t_s, poses.rotations, shifts, valid)
    found = estimate_latency(LatencyRecording(cut, whole.wall_row_px))
    assert found.lag_s == pytest.approx(0.05, abs=0.001)


def synthetic(seed: int, **changes: float) -> tuple[LatencyRecording, float]:
    """A recording of the synthetic world, with sway, jitter and noise, and its true lag."""
    probe, options, rng = SectorProbe(), Preset(), np.random.default_rng([seed, 7])
    truth = draw_ground_truth(np.zeros(3), probe.plane_from_image, 150.0, rng)
    spec = replace(options.watertank, **changes)
    tracker = options.watertank_tracker
    made = watertank_recording(truth.probe_from_image, probe.fan, truth.lag_s, tracker, spec, rng)
    return made, truth.lag_s


def test_the_interval_holds_the_truth_as_often_as_it_says() -> None:
    inside, widths = [], []
    for seed in range(1400, 1440):
        made, truth = synthetic(seed)
        found = estimate_latency(made)
        assert abs(found.lag_s - truth) < 0.002
        inside.append(found.interval_s[0] <= truth <= found.interval_s[1])
        widths.append(found.interval_s[1] - found.interval_s[0])
    # 40 trials at 95 %: fewer than 34 happen once in 250 times
    assert sum(inside) >= 34
    assert np.mean(widths) < 0.003, "and it is no wider than it must be: the error's SD is 0.43 ms"


def test_a_drifting_lag_widens_the_interval_and_is_reported() -> None:
    steady = recording(-0.06)
    rows = steady.wall_row_px
    # the video's clock drifts by 60 ms and jumps back every 5 s
    drifting = Trace(rows.t_s + 0.06 * ((rows.t_s % 5.0) / 5.0 - 0.5), rows.values)
    found = estimate_latency(LatencyRecording(steady.tracker_from_probe, drifting))
    calm = estimate_latency(steady)
    assert found.wander_s == pytest.approx(0.06 / np.sqrt(12), rel=0.35)
    assert calm.wander_s < 0.002
    assert found.interval_s[0] < -0.06 < found.interval_s[1]
    assert np.ptp(found.interval_s) > 5 * np.ptp(calm.interval_s)


def test_real_water_tank_with_plus_lines(data_dir: Path) -> None:
    folder = data_dir / "plus-temporal-watertank"
    tracker = folder / "WaterTankBottomTranslationTrackerBuffer-trimmed.igs.mha"
    video = folder / "WaterTankBottomTranslationVideoBuffer.igs.mha"
    table = folder / "LineSegmentationResultsBaseline.xml"
    found = estimate_latency(read_latency_recording(tracker, video, table))
    assert found.lag_s == pytest.approx(-0.0648, abs=0.002)
    assert found.second_lag_s == pytest.approx(0.448, abs=0.01)
    assert found.second_sigmas > 3.0
    assert abs(found.halves_s[0] - found.halves_s[1]) < 0.005
    assert found.interval_s[0] < -0.0648 < found.interval_s[1]
    # this recording's own video clock drifts by a frame period and jumps back, every 7 s
    assert found.wander_s == pytest.approx(0.028, abs=0.003)
    frames = read_sequence(video)
    assert frames.images is not None
    rows = wall_trace(frames.t_s, frames.images, frames.image_valid, rng=np.random.default_rng(0))
    own = estimate_latency(LatencyRecording(read_sequence(tracker).stream("tracker", "probe"), rows))
    assert own.lag_s == pytest.approx(-0.0648, abs=0.002)
    assert own.interval_s == pytest.approx(found.interval_s, abs=0.002)
