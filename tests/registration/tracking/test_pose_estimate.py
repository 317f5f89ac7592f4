"""One beat's slices tell a good pose from a wrong one, and a filter over beats follows a slow drift."""

from dataclasses import replace

import numpy as np
import pytest
from followed_shape import followed_shape
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import HEART_RADIUS_MM, Rigid, Warp, mean_displacement_mm
from dvf_ig.core.space.warp import RIGID_SIGMA_MM, knots
from dvf_ig.registration import BeatMeasurement, Lc2, PoseChart, PoseEstimate, channels_from_mr, measure_beat
from dvf_ig.registration.pose_chart import covariance_from_mm, rigid_motion
from dvf_ig.registration.shape.estimate import PROCESS_NOISE_MM, GuardedWalls
from dvf_ig.registration.tracking.pose_estimate import TARGET_RADIUS_MM

MR = toy_mr()
MODEL = channels_from_mr(MR, smoothing_mm=2.0)
TRUTH = toy_pose()
BEAT = np.arange(6)


def beat(pose: Rigid, seed: int, *, first: int = 0) -> Lc2:
    """Six of twelve slices through a heart that lies at `pose`."""
    slices = toy_slices(MR, pose, np.random.default_rng(seed), pitch_mm=3.0, speckle=0.05)
    return Lc2(slices.subset((first + 2 * BEAT) % 12), MODEL, patch_mm=13.0, pitch_mm=3.0)


def estimate(pose: Rigid, sigma_mm: float) -> PoseEstimate:
    return PoseEstimate(pose, sigma_mm**2 * np.eye(6), CENTER_MM, 0.5**2 * np.eye(6))


def test_an_update_of_one_coordinate_is_the_scalar_kalman_filter() -> None:
    information = np.zeros((6, 6))
    information[4, 4] = 1 / 0.8**2
    updated = estimate(TRUTH, 0.6).update(information @ np.full(6, 2.0), information)
    gain = 0.6**2 / (0.6**2 + 0.8**2)
    offset = PoseChart(TRUTH, CENTER_MM).coordinates(updated.pose)
    np.testing.assert_allclose(offset, [0, 0, 0, 0, 2.0 * gain, 0], atol=1e-9)
    np.testing.assert_allclose(
        np.diag(updated.covariance_mm2), [0.36, 0.36, 0.36, 0.36, 0.36 * (1 - gain), 0.36]
    )


def test_beats_are_measured_where_a_heart_of_another_shape_matches() -> None:
    """Images match at TRUTH; the heart lies 2 mm from there, for the part that is seen has moved so far."""
    shape_step = PoseChart(TRUTH, CENTER_MM).pose(np.array([0, 0, 0, 0, 2.0, 0]))
    covariance = np.eye(6)
    moved = PoseEstimate.from_registration(shape_step, covariance, covariance, CENTER_MM, TRUTH)
    np.testing.assert_allclose(moved.matched_pose.matrix, TRUTH.matrix, atol=1e-9)
    found = measure_beat(beat(TRUTH, 3), moved.matched_pose, CENTER_MM).of(moved, 0.0)
    assert found.pose is moved.pose
    assert mean_displacement_mm(found.best, moved.pose, CENTER_MM) < 0.5
    updated = moved.update(found.offset_information_mm, found.information)
    assert mean_displacement_mm(updated.pose, moved.pose, CENTER_MM) < 0.5
    plain = estimate(TRUTH, 0.6)
    assert plain.matched_pose is plain.pose


def test_a_beat_of_a_followed_heart_is_measured_where_the_change_of_shape_in_its_plane_puts_it() -> None:
    """The change of shape is a rigid motion as far as the plane shows, known to 0.9 mm there."""
    aside = PoseChart(TRUTH, CENTER_MM).pose(np.array([1.0, -0.5, 0.8, 2.0, -1.0, 3.0]))
    motion = TRUTH @ aside.inverse()
    origin = CENTER_MM - 120.0
    places = knots(origin, 20.0)
    m_mm = places - motion.apply_array(places)
    warp = Warp.through("mr", origin, 20.0, m_mm, np.full(len(places), 0.81))
    followed = replace(estimate(aside, 0.6), shape=followed_shape(warp))
    view_mm = aside.inverse().apply_array(CENTER_MM + np.array([[-20.0, 0, 0], [20.0, 0, 5], [0, 30.0, 0]]))
    pose, variance_mm2 = followed.matched_in(view_mm)
    np.testing.assert_allclose(pose.matrix, TRUTH.matrix, atol=1e-3)
    assert variance_mm2 == pytest.approx(0.81 - RIGID_SIGMA_MM**2, abs=1e-5)
    there = measure_beat(beat(TRUTH, 3), pose, CENTER_MM)
    sure, unsure = there.of(followed, 0.0), there.of(followed, variance_mm2)
    assert (sure.variance_mm2, unsure.variance_mm2) == (0.0, variance_mm2)
    still = followed.update(unsure.offset_information_mm, unsure.information, certain=False)
    assert still.moved_by_beats is followed.pose
    updated = followed.update(unsure.offset_information_mm, unsure.information)
    assert (updated.pose, updated.warp) == (followed.pose, warp)
    assert sure.of(updated, 0.0).pose is updated.matching
    again, _ = updated.matched_in(view_mm)
    np.testing.assert_allclose(
        PoseChart(pose, CENTER_MM).coordinates(again),
        updated.covariance_mm2 @ unsure.offset_information_mm,
        atol=0.05,
    )
    assert sure.pose is followed.pose
    np.testing.assert_allclose(
        np.linalg.inv(unsure.information),
        np.linalg.inv(sure.information) + variance_mm2 * np.eye(6),
        rtol=1e-6,
    )
    np.testing.assert_allclose(
        np.linalg.solve(unsure.information, unsure.offset_information_mm),
        np.linalg.solve(sure.information, sure.offset_information_mm),
        rtol=1e-6,
    )


def test_an_uncertain_change_of_shape_explains_a_small_offset_and_hardly_a_large_one() -> None:
    measured = measure_beat(beat(TRUTH, 3), TRUTH, CENTER_MM)
    followed = estimate(PoseChart(TRUTH, CENTER_MM).pose(np.full(6, 0.1)), 0.6)

    def ratio(offset_mm: float, told: float) -> float:
        offset = measured.information @ np.array([0, 0, 0, 0, offset_mm, 0])
        there = replace(measured, offset_information_mm=offset, log_likelihood_ratio=told)
        return there.of(followed, 1.0).log_likelihood_ratio

    assert ratio(1.5, 6.0) < 2.0
    assert ratio(8.0, 12.0) > 8.0


def test_a_registration_that_shares_frames_with_the_beats_leaves_the_tracked_pose_as_certain_as_it_was() -> (
    None
):
    offset = np.array([0.5, 0, -0.4, 1.0, -0.8, 0.3])
    covariance = np.diag([(0.5 / HEART_RADIUS_MM) ** 2] * 3 + [0.5**2] * 3)
    first = PoseEstimate.from_registration(TRUTH, covariance, covariance, CENTER_MM)
    assert first.total_mm2[4, 4] == pytest.approx(2 * 0.5**2)
    tracked = first.update(np.zeros(6), np.eye(6) / 0.2**2)
    again = PoseEstimate.from_registration(
        PoseChart(TRUTH, CENTER_MM).pose(offset), covariance, covariance, CENTER_MM
    )
    fused = tracked.intersected_with(again, 0.0)
    np.testing.assert_allclose(fused.covariance_mm2, tracked.covariance_mm2)
    np.testing.assert_allclose(fused.shared_mm2, 0.5**2 * np.eye(6), atol=1e-9)


def test_a_registration_renews_a_pose_that_beats_hold_less_well() -> None:
    covariance = np.diag([(0.5 / HEART_RADIUS_MM) ** 2] * 3 + [0.5**2] * 3)
    registered = PoseEstimate.from_registration(TRUTH, covariance, covariance, CENTER_MM)
    renewed = registered.predict(100.0).intersected_with(registered, 4.0)
    expected = 0.5**2 + 4 * PROCESS_NOISE_MM**2
    np.testing.assert_allclose(np.diag(renewed.covariance_mm2), expected)
    np.testing.assert_allclose(renewed.shared_mm2, 0.5**2 * np.eye(6), atol=1e-9)


def test_a_registration_that_pulls_images_aside_otherwise_leaves_open_where_beats_match() -> None:
    covariance = np.diag([(0.5 / HEART_RADIUS_MM) ** 2] * 3 + [0.5**2] * 3)
    matched, elsewhere = (PoseChart(TRUTH, CENTER_MM).pose(np.array([0, 0, 0, 0, y, 0])) for y in (1.0, -1.0))
    tracked = PoseEstimate.from_registration(TRUTH, covariance, covariance, CENTER_MM, matched)
    again = PoseEstimate.from_registration(TRUTH, covariance, covariance, CENTER_MM, elsewhere)
    fused = tracked.intersected_with(again, 0.0)
    np.testing.assert_allclose(fused.matched_pose.matrix, elsewhere.matrix, atol=1e-9)
    assert fused.covariance_mm2[4, 4] == pytest.approx(0.5**2 + 2.0**2)
    same = tracked.intersected_with(tracked, 0.0)
    np.testing.assert_allclose(same.covariance_mm2, tracked.covariance_mm2, atol=1e-9)


def test_the_bound_holds_the_rms_error_over_the_targets_in_95_percent() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * 0.5
    held = PoseEstimate(TRUTH, root @ root.T, CENTER_MM, 0.3**2 * np.eye(6))
    drawn = rng.multivariate_normal(np.zeros(6), held.total_mm2, 4000)
    chart = PoseChart(TRUTH, CENTER_MM)
    directions = np.vstack([np.eye(3), -np.eye(3)])  # their mean square distance is that of a sphere
    targets = TRUTH.inverse().apply_array(CENTER_MM + TARGET_RADIUS_MM * directions)

    def rms_mm(pose: Rigid) -> float:
        return float(np.sqrt(((pose.apply_array(targets) - TRUTH.apply_array(targets)) ** 2).sum(1).mean()))

    far = [rms_mm(chart.pose(xi)) > held.pose_bound_mm for xi in drawn[:1000]]
    assert 0.03 < np.mean(far) < 0.07


def test_the_error_of_a_heart_covered_in_part_is_its_covariance_however_large_its_noise_is_said_to_be() -> (
    None
):
    """Its noise is part of it: counted twice, it alone takes a stack's bound past the limit."""
    root = np.random.default_rng(8).normal(size=(6, 6))
    covariance_mm2 = root @ root.T + 0.1 * np.eye(6)
    noise_mm2 = np.diag([0.01, 0.01, 0.01, 0.01, 25.0, 0.01])
    covariance, noise = covariance_from_mm(covariance_mm2), covariance_from_mm(noise_mm2)
    part = CENTER_MM + 40.0 * np.vstack([np.eye(3), -np.eye(3)])
    registered = PoseEstimate.from_registration(TRUTH, covariance, noise, CENTER_MM, targets_mm=part)
    np.testing.assert_allclose(registered.total_mm2, covariance_mm2, rtol=1e-9, atol=1e-12)
    for share in (registered.covariance_mm2, registered.shared_mm2, noise_mm2 - registered.covariance_mm2):
        assert np.linalg.eigvalsh(share).min() > -1e-9
    improved = registered.update(np.zeros(6), 1e6 * np.eye(6))
    np.testing.assert_allclose(improved.total_mm2, registered.shared_mm2, atol=1e-5)
    whole = PoseEstimate.from_registration(TRUTH, covariance, noise, CENTER_MM)
    np.testing.assert_allclose(whole.total_mm2, covariance_mm2 + noise_mm2, rtol=1e-9)


def test_the_bound_of_a_followed_shape_holds_the_error_of_its_walls_in_95_percent() -> None:
    rng = np.random.default_rng(6)
    normals = rng.normal(size=(30, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    moved = np.einsum("ni,nip->np", normals, rigid_motion(CENTER_MM + 40.0 * normals, CENTER_MM))
    alike = 0.3 * rng.normal(size=(30, 5))
    known = alike @ alike.T
    walls = GuardedWalls(moved.T @ moved / 30, float(np.trace(known)) / 30, float((known**2).sum()) / 30**2)
    still = Warp("mr", np.zeros(3), 16.0, np.zeros((15, 15, 15, 4), np.float32))
    held = replace(estimate(TRUTH, 0.4), shape=followed_shape(still, walls))
    beats = moved @ rng.multivariate_normal(np.zeros(6), held.covariance_mm2, 4000).T
    off = beats + alike @ rng.normal(size=(5, 4000))
    assert 0.03 < np.mean(np.sqrt((off**2).mean(axis=0)) > held.pose_bound_mm) < 0.07
    unfollowed = estimate(TRUTH, 0.4)
    fused = unfollowed.intersected_with(held, 0.0).shape
    assert fused is not None
    assert fused.walls is walls
    assert held.intersected_with(unfollowed, 0.0).pose_bound_mm == unfollowed.pose_bound_mm


def test_prediction_adds_process_noise_to_a_registrations_covariance() -> None:
    covariance = np.diag([0.01**2] * 3 + [0.4**2] * 3)
    registered = PoseEstimate.from_registration(TRUTH, covariance, covariance, CENTER_MM)
    expected = [(0.01 * HEART_RADIUS_MM) ** 2] * 3 + [0.4**2] * 3
    np.testing.assert_allclose(np.diag(registered.covariance_mm2), expected)
    older = registered.predict(9.0)
    np.testing.assert_allclose(np.diag(older.covariance_mm2), np.array(expected) + 9 * PROCESS_NOISE_MM**2)
    assert older.pose is TRUTH


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_beat_tells_a_good_pose_from_a_wrong_one(seed: int) -> None:
    metric = beat(TRUTH, seed)
    good = measure_beat(metric, TRUTH, CENTER_MM)
    wrong_pose = TRUTH.perturbed_left([0.04, -0.03, 0.02], [5.0, -4.0, 4.0], CENTER_MM)
    wrong = measure_beat(metric, wrong_pose, CENTER_MM)
    assert good.moved_mm < 0.5
    assert good.log_likelihood_ratio < 0.1
    assert mean_displacement_mm(wrong.best, TRUTH, CENTER_MM) < 1.5
    assert wrong.log_likelihood_ratio > 7.0
    assert np.linalg.eigvalsh(good.information).min() >= -1e-9


def test_offset_is_that_of_the_optimum_of_the_slices() -> None:
    """With much known before, the estimate stays; with nothing known, it goes to the slices' optimum."""
    start = TRUTH.perturbed_left([0.0, 0.0, 0.0], [3.0, 0.0, 0.0], CENTER_MM)
    measurement = measure_beat(beat(TRUTH, 4), start, CENTER_MM)
    sure = estimate(start, 0.01).update(measurement.offset_information_mm, measurement.information)
    unsure = estimate(start, 6.0).update(measurement.offset_information_mm, measurement.information)
    assert mean_displacement_mm(sure.pose, start, CENTER_MM) < 0.05
    assert mean_displacement_mm(unsure.pose, measurement.best, CENTER_MM) < 0.5


def tracked(drift_mm: np.ndarray, beats: int) -> tuple[PoseEstimate, Rigid, list[BeatMeasurement]]:
    now, truth, measurements = estimate(TRUTH, 0.5), TRUTH, []
    for k in range(beats):
        truth = PoseChart(truth, CENTER_MM).pose(drift_mm)
        measurement = measure_beat(beat(truth, 10 + k, first=k), now.pose, CENTER_MM)
        now = now.predict(1.0).update(measurement.offset_information_mm, measurement.information)
        measurements.append(measurement)
    return now, truth, measurements


def test_a_slow_drift_is_followed_and_contradicts_no_pose() -> None:
    now, truth, measurements = tracked(np.array([0.05, 0.0, -0.05, 0.12, -0.1, 0.08]), 16)
    assert mean_displacement_mm(TRUTH, truth, CENTER_MM) > 2.5
    assert mean_displacement_mm(now.pose, truth, CENTER_MM) < 1.0
    assert max(measurement.log_likelihood_ratio for measurement in measurements) < 5.0


def test_beats_do_not_make_a_still_pose_noisier() -> None:
    now, truth, _ = tracked(np.zeros(6), 12)
    assert mean_displacement_mm(now.pose, truth, CENTER_MM) < 0.4
    assert np.sqrt(np.trace(now.covariance_mm2) / 6) < 0.5


def test_a_beat_is_informative_where_it_shows_the_heart_and_not_where_it_shows_noise() -> None:
    shown = measure_beat(beat(TRUTH, 3), TRUTH, CENTER_MM)
    assert shown.informative
    rng = np.random.default_rng(4)
    for images in (np.zeros((12, 43, 43)), rng.uniform(0.0, 1.0, (12, 43, 43))):
        slices = toy_slices(MR, TRUTH, np.random.default_rng(3), pitch_mm=3.0, speckle=0.05)
        blind = replace(slices, images=images.astype(np.float32)).subset(2 * BEAT)
        measurement = measure_beat(Lc2(blind, MODEL, patch_mm=13.0, pitch_mm=3.0), TRUTH, CENTER_MM)
        assert not measurement.informative
        assert measurement.log_likelihood_ratio < 5.0


def test_the_bound_is_over_the_targets_that_are_given() -> None:
    turning = np.diag([4.0, 4.0, 4.0, 1e-9, 1e-9, 1e-9])
    near = CENTER_MM + 0.2 * HEART_RADIUS_MM * np.vstack([np.eye(3), -np.eye(3)])
    covariance = covariance_from_mm(turning)
    nothing = np.zeros((6, 6))
    heart = PoseEstimate.from_registration(TRUTH, covariance, nothing, CENTER_MM)
    part = PoseEstimate.from_registration(TRUTH, covariance, nothing, CENTER_MM, targets_mm=near)
    assert part.pose_bound_mm == pytest.approx(heart.pose_bound_mm * 0.2 * HEART_RADIUS_MM / TARGET_RADIUS_MM)
