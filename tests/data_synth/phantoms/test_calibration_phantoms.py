"""Pivot, N-wire and water-tank recordings hold the ground truth, to within their own noise."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.phantoms.nwire import NWireSpec, fcal_phantom, nwire_recording, wire_crossings_px
from data_synth.phantoms.pivot import pivot_recording
from data_synth.phantoms.watertank import WaterTankSpec, watertank_recording
from data_synth.scenario.ground_truth import (
    LANDMARK_RMS_MM,
    GroundTruth,
    coarse_start,
    draw_ground_truth,
    touched_landmarks,
)
from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, Landmarks, LatencyRecording, NWireRecording, Points

PROBE = SectorProbe()
EXACT = TrackerSpec(rate_hz=20.0, jitter_s=0.0, stamp_noise_s=0.0, position_mm=0.0, rotation_deg=0.0)


def ground_truth(seed: int = 1) -> GroundTruth:
    return draw_ground_truth(
        np.array([5.0, -40.0, 20.0]), PROBE.plane_from_image, 150.0, np.random.default_rng(seed)
    )


def solved_pivot(seed: int, spec: TrackerSpec) -> tuple[FloatArray, FloatArray]:
    """Tip error (3,) and residuals (n, 3) of the least-squares tip."""
    tip = ground_truth(seed).tip_in_tool
    stream = pivot_recording(tip, spec, np.random.default_rng(seed))
    n = len(stream)
    matrix = np.concatenate([stream.rotations, -np.tile(np.eye(3), (n, 1, 1))], axis=2).reshape(-1, 6)
    target = -stream.translations_mm.reshape(-1)
    solution = np.linalg.lstsq(matrix, target, rcond=None)[0]
    return solution[:3] - tip.xyz_mm[0], (matrix @ solution - target).reshape(-1, 3)


@pytest.mark.parametrize("seed", [1, 2])
def test_pivot_recording_gives_the_tip_back(seed: int) -> None:
    spec = TrackerSpec(rate_hz=20.0, position_mm=0.1, rotation_deg=0.05)
    error, residuals = solved_pivot(seed, spec)
    per_axis_mm = np.hypot(0.1 / np.sqrt(3), np.deg2rad(0.05) / np.sqrt(3) * 150 * np.sqrt(2 / 3))
    per_axis_mm = np.hypot(per_axis_mm, 0.05 / np.sqrt(3))
    assert residuals.std() == pytest.approx(per_axis_mm, rel=0.25)
    assert np.linalg.norm(error) < 5 * per_axis_mm * np.sqrt(3 / 300) / np.sin(np.deg2rad(15))


def test_pivot_poses_span_more_than_40_degrees() -> None:
    stream = pivot_recording(ground_truth().tip_in_tool, EXACT, np.random.default_rng(1))
    assert len(stream) == 300
    turns = Rotation.from_matrix(stream.rotations)
    span = max(float((turns[i].inv() * turns).magnitude().max()) for i in range(0, 300, 10))
    assert np.degrees(span) > 40.0


def nwire(seed: int, tracker: TrackerSpec = EXACT, **changes: float) -> NWireRecording:
    return nwire_recording(
        ground_truth(seed).probe_from_image,
        PROBE.fan,
        (PROBE.columns, PROBE.rows),
        tracker,
        NWireSpec(**changes),
        np.random.default_rng(seed),
    )


@pytest.mark.parametrize("seed", [1, 2])
def test_exact_crossings_lie_on_their_wires(seed: int) -> None:
    recording = nwire(seed, point_noise_mm=0.0, failed_share=0.0)
    probe_from_image = ground_truth(seed).probe_from_image
    for i in range(len(recording.phantom_from_probe)):
        phantom_from_probe = recording.phantom_from_probe.pose(i)
        seen = phantom_from_probe.apply(probe_from_image.apply_pixels(recording.points_px[i])).xyz_mm
        for wire, point in zip(recording.phantom.wires, seen, strict=True):
            along = (wire.back_mm - wire.front_mm) / np.linalg.norm(wire.back_mm - wire.front_mm)
            reach = (point - wire.front_mm) @ along
            assert np.linalg.norm(point - wire.front_mm - reach * along) < 1e-9
            assert 0 < reach < np.linalg.norm(wire.back_mm - wire.front_mm)


def test_wire_points_lie_in_the_sector_at_many_depths() -> None:
    recording = nwire(1, point_noise_mm=0.0, failed_share=0.0)
    mask = PROBE.fan.mask(PROBE.rows, PROBE.columns)
    column, row = np.round(recording.points_px).astype(int).reshape(-1, 2).T
    assert mask[row, column].all()
    depth_mm = (recording.points_px[..., 1] - PROBE.fan.apex_px[1]) * PROBE.mm_per_px[1]
    assert np.ptp(depth_mm) > 60.0


def test_point_noise_and_failed_frames_are_as_stated() -> None:
    exact, noisy = nwire(2, point_noise_mm=0.0, failed_share=0.0), nwire(2)
    error_mm = (noisy.points_px - exact.points_px) * PROBE.mm_per_px[1]
    failed = np.isnan(noisy.points_px).any(axis=(1, 2))
    assert np.array_equal(failed, np.isnan(noisy.points_px).all(axis=(1, 2)))
    assert 0 < failed.mean() < 0.15
    assert np.nanstd(error_mm) == pytest.approx(0.2, rel=0.05)


def test_phantom_is_two_parallel_wires_and_a_diagonal_each() -> None:
    phantom = fcal_phantom()
    assert [wire.name for wire in phantom.wires][:3] == ["7:G1_g1", "8:L1_h1", "9:M1_m1"]
    for left, middle, right in phantom.patterns:
        for outer in (left, right):
            np.testing.assert_array_equal((outer.back_mm - outer.front_mm), [0.0, 40.0, 0.0])
        assert middle.front_mm[2] == left.front_mm[2] == right.front_mm[2]
        assert abs(middle.back_mm[0] - middle.front_mm[0]) >= 15.0


def test_crossing_of_an_upright_plane_has_its_closed_form() -> None:
    phantom_from_image = np.eye(4)
    phantom_from_image[:3, :3] = np.array([[0.5, 0, 0], [0, 0, 1], [0, -0.5, 0]])
    phantom_from_image[:3, 3] = [0.0, 20.0, 50.0]
    pixels, fraction = wire_crossings_px(fcal_phantom(), phantom_from_image)
    np.testing.assert_allclose(fraction, 0.5)
    np.testing.assert_allclose(pixels[1], [90.0, 60.0])
    np.testing.assert_allclose(pixels[8], [120.0, 100.0])


def lag_by_correlation(recording: LatencyRecording) -> float:
    """Lag of the best match between the floor's row and the tracked height, 0.5 ms steps."""
    stream, rows = recording.tracker_from_probe, recording.wall_row_px
    height = stream.translations_mm - stream.translations_mm.mean(axis=0)
    axis = np.linalg.svd(height, full_matrices=False)[2][0]
    motion = height @ axis
    lags = np.arange(-0.3, 0.3, 0.0005)
    score = [
        abs(np.corrcoef(np.interp(rows.t_s + lag, stream.t_s, motion), rows.values)[0, 1]) for lag in lags
    ]
    return float(lags[int(np.argmax(score))])


@pytest.mark.parametrize("seed", [1, 2])
def test_watertank_holds_the_true_lag_with_the_stated_sign(seed: int) -> None:
    truth = ground_truth(seed)
    assert 0.02 <= abs(truth.lag_s) <= 0.08
    recording = watertank_recording(
        truth.probe_from_image,
        PROBE.fan,
        truth.lag_s,
        TrackerSpec(rate_hz=50.0),
        WaterTankSpec(),
        np.random.default_rng(seed),
    )
    assert recording.tracker_from_probe.rate_hz == pytest.approx(50.0, rel=0.02)
    assert abs(lag_by_correlation(recording) - truth.lag_s) < 0.003


def test_watertank_rows_are_the_depth_in_the_image_of_the_probe() -> None:
    spec = WaterTankSpec(row_noise_mm=0.0, sway_mm=0.0, sway_deg=0.0, video_jitter_s=0.0)
    truth = ground_truth(5)
    recording = watertank_recording(
        truth.probe_from_image, PROBE.fan, 0.05, EXACT, spec, np.random.default_rng(5)
    )
    depth = (recording.wall_row_px.values - PROBE.fan.apex_px[1]) * PROBE.mm_per_px[1]
    assert depth.mean() == pytest.approx(85.0, abs=1.0)
    assert np.ptp(depth) == pytest.approx(20.0, rel=0.25)
    assert np.unique(recording.wall_row_px.values).size > 0.9 * len(depth)


def test_image_pose_and_plane_pose_are_the_same_image() -> None:
    truth = ground_truth(6)
    apex = truth.probe_from_image.apply_pixels(np.array([PROBE.apex_px])).xyz_mm[0]
    np.testing.assert_allclose(apex, truth.probe_from_plane.translation_mm, atol=1e-9)
    below = truth.probe_from_image.apply_pixels(np.add([PROBE.apex_px], [0.0, 100.0])).xyz_mm[0]
    expected = truth.probe_from_plane.apply_array(np.array([0.0, 50.0, 0.0]))
    np.testing.assert_allclose(below, expected, atol=1e-9)


def test_the_start_is_off_by_exactly_what_was_asked() -> None:
    truth, center = ground_truth(7), np.array([5.0, -40.0, 20.0])
    start = coarse_start(truth.mr_from_tracker, center, 10.0, 8.0, np.random.default_rng(1))
    difference = start @ truth.mr_from_tracker.inverse()
    assert np.degrees(difference.angle_rad) == pytest.approx(8.0, abs=1e-9)
    assert np.linalg.norm(difference.apply_array(center) - center) == pytest.approx(10.0, abs=1e-9)


def test_touched_landmarks_carry_three_millimetres() -> None:
    truth = ground_truth(8)
    points = np.random.default_rng(2).uniform(-50, 50, (4000, 3))
    exact = Landmarks(tuple(f"p{i}" for i in range(4000)), Points("mr", points))
    touched = touched_landmarks(exact, truth.mr_from_tracker, np.random.default_rng(3))
    error = truth.mr_from_tracker.apply(touched.points).xyz_mm - points
    assert np.sqrt((error**2).sum(axis=1).mean()) == pytest.approx(LANDMARK_RMS_MM, rel=0.03)
    assert touched.frame == "tracker"
