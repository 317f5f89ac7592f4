"""Touched surface points: a start, its evidence, and a check of a pose, on surfaces whose pose is known."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from toy_touched import beating_model, grid_targets, heart_center_mm, pose_off, random_pose, touched_points

from dvf_ig.core import (
    CycleTiming,
    FrameMismatchError,
    InvalidInputError,
    MissingDependencyError,
    Points,
    Rigid,
    Stop,
    SurfaceSeries,
    TouchedPoints,
    Warp,
)
from dvf_ig.core.space.warp import CELLS, knots
from dvf_ig.io import read_surface_series
from dvf_ig.preop import ModelOptions, model_from_surfaces
from dvf_ig.registration import (
    PoseChart,
    TouchedSurface,
    start_from_surface_points,
    target_errors_mm,
)
from dvf_ig.registration.surface_points.touched import SurfaceDistance

SEED = 201


def known(model, seed, **how):
    """Generator, true pose, points touched at it, and a start 20 mm and 20° off."""
    rng = np.random.default_rng(seed)
    truth = random_pose(rng)
    touched = touched_points(model, truth, rng, **how)
    return rng, truth, touched, pose_off(truth, rng, heart_center_mm(model), 20.0, 20.0)


@pytest.fixture(scope="module")
def heart():
    return beating_model()


@pytest.fixture(scope="module")
def fitted(heart):
    """The truth, the points, and their fit from a coarse start."""
    rng, truth, touched, start = known(heart, SEED, count=60, noise_mm=0.5)
    return (
        truth,
        touched,
        start_from_surface_points(touched, heart, heart_center_mm(heart), rng=rng, start=start),
    )


def test_start_is_found_from_20_mm_and_20_degrees(heart, fitted):
    truth, touched, fit = fitted
    assert fit.stop is Stop.CONVERGED
    assert fit.sentence == "converged"
    assert target_errors_mm(fit.target_from_source, truth, grid_targets(heart)).mean() < 2.0
    assert 0.85 <= fit.inliers.mean() < 1.0
    assert touched.sigma_mm <= fit.sigma_mm < 2 * touched.sigma_mm


def test_outliers_are_found(heart, fitted):
    truth, touched, fit = fitted
    off = np.abs(SurfaceDistance(touched, heart, np.zeros(3)).residuals_mm(truth)) > 4.0
    assert off.any()
    assert not fit.inliers[off].any()


def test_covariance_explains_the_error(heart, fitted):
    truth, _, fit = fitted
    chart = PoseChart(fit.target_from_source, fit.center_mm)
    xi = chart.coordinates(truth) / np.array([40.0] * 3 + [1.0] * 3)
    assert xi @ np.linalg.solve(fit.covariance, xi) < 22.5  # 99.9 % of chi-squared with 6 degrees of freedom
    assert fit.weakest.sigma_mm < 3.0


def test_without_a_start_all_rotations_are_searched(heart, fitted):
    _, touched, near = fitted
    fit = start_from_surface_points(touched, heart, near.center_mm, rng=np.random.default_rng(0))
    assert fit.starts == 60
    assert fit.stop is Stop.CONVERGED
    assert fit.runner_up is not None
    assert fit.runner_up.cost_gap > 8.0
    np.testing.assert_allclose(fit.target_from_source.matrix, near.target_from_source.matrix, atol=1e-2)


def test_result_repeats_bit_for_bit(heart, fitted):
    rng, _, touched, start = known(heart, SEED, count=60, noise_mm=0.5)
    again = start_from_surface_points(touched, heart, heart_center_mm(heart), rng=rng, start=start)
    np.testing.assert_array_equal(again.target_from_source.matrix, fitted[2].target_from_source.matrix)


def test_turning_of_a_ball_is_undetermined():
    ball = beating_model(bumps=0.0)
    rng, _, touched, start = known(ball, SEED, count=40, noise_mm=0.5)
    fit = start_from_surface_points(touched, ball, heart_center_mm(ball), rng=rng, start=start)
    assert fit.stop is Stop.WEAK_GEOMETRY
    assert not fit.stop.usable
    assert fit.weakest.turning
    assert "turning about" in fit.sentence
    assert fit.runner_up is not None
    assert fit.runner_up.cost_gap < 8.0


def test_second_pose_that_fits_as_well_is_ambiguous(heart):
    stretched = mirror_symmetric()
    rng, _, touched, _ = known(stretched, SEED, count=60, noise_mm=0.5, facing=-2.0)
    fit = start_from_surface_points(touched, stretched, heart_center_mm(stretched), rng=rng)
    assert fit.stop is Stop.AMBIGUOUS
    assert fit.runner_up is not None
    assert fit.runner_up.cost_gap < 8.0
    assert f"{fit.runner_up.apart_mm:.0f} mm away" in fit.sentence


def mirror_symmetric():
    """An ellipsoid that does not move: half turns about its axes map it on itself."""
    ball = beating_model(bumps=0.0).reference[0]
    vertices = ball.vertices_mm * [1.0, 0.75, 1.25]
    series = SurfaceSeries(
        "EPICARDIAL", "mr", np.stack([vertices] * 2), ball.triangles, CycleTiming.uniform(2, 0.8), "ellipsoid"
    )
    return model_from_surfaces(series, options=ModelOptions(knot_spacing_mm=6.0))


def test_points_of_another_heart_do_not_match(heart):
    rng, _, touched, start = known(heart, SEED, count=40, noise_mm=0.5)
    far = Points("tracker", touched.points.xyz_mm * 1.4)
    other = TouchedPoints(far, touched.model_phase, 0.5)
    fit = start_from_surface_points(other, heart, heart_center_mm(heart), rng=rng, start=start)
    assert fit.stop is Stop.POOR_MATCH
    assert "stylus tip" in fit.sentence


def test_derivatives_are_those_of_the_distance(heart):
    _, truth, touched, start = known(heart, SEED)
    distance = SurfaceDistance(touched, heart, heart_center_mm(heart))
    for pose in (truth, start, truth.perturbed_left([0, 0, 0], [0.0, 60.0, 0.0], [0, 0, 0])):
        chart = PoseChart(pose, heart_center_mm(heart))
        _, jacobian = distance.linearised(pose)
        steps = 1e-4 * np.eye(6)
        numeric = [
            (distance.residuals_mm(chart.pose(s)) - distance.residuals_mm(chart.pose(-s))) / 2e-4
            for s in steps
        ]
        np.testing.assert_allclose(jacobian, np.transpose(numeric), atol=2e-4)


def test_each_point_is_compared_at_its_own_phase(heart):
    """At a wrong phase the surface is 8 % smaller: some 3 mm."""
    _, truth, touched, _ = known(heart, SEED, noise_mm=0.1, outlier_share=0.0)
    right = SurfaceDistance(touched, heart, np.zeros(3)).residuals_mm(truth)
    wrong = TouchedPoints(touched.points, (touched.model_phase + 0.35) % 1.0, 0.1)
    assert np.median(np.abs(right)) < 0.2
    assert np.median(np.abs(SurfaceDistance(wrong, heart, np.zeros(3)).residuals_mm(truth))) > 1.0


def test_check_tells_a_right_pose_from_a_wrong_one(heart):
    rng, truth, touched, _ = known(heart, SEED, noise_mm=1.0)
    right = TouchedSurface(touched, heart).disagreement(truth)
    assert right.agrees
    assert "agrees" in right.sentence
    wrong = TouchedSurface(touched, heart).disagreement(
        pose_off(truth, rng, heart_center_mm(heart), 12.0, 0.0)
    )
    assert not wrong.agrees
    assert wrong.median_mm > wrong.limit_mm == right.limit_mm
    assert "wrong" in wrong.sentence


def test_check_goes_through_a_change_of_shape(heart):
    """The heart is 15 % larger, or contracts 0.6 times as far."""
    _, truth, touched, _ = known(heart, SEED, noise_mm=0.5, outlier_share=0.0)
    model_mm = truth.apply(touched.points).xyz_mm
    low, high = model_mm.min(axis=0) - 30.0, model_mm.max(axis=0) + 30.0
    pitch_mm = float((high - low).max()) / CELLS
    at = knots(low, pitch_mm)
    m_mm = 0.15 / 1.15 * (at - heart_center_mm(heart))
    warp = Warp.through("mr", low, pitch_mm, m_mm, np.full(len(at), 0.3))
    patient = truth.inverse().apply(Points("mr", warp.patient_places(model_mm)))
    moved = TouchedSurface(replace(touched, points=patient), heart)
    assert not moved.disagreement(truth).agrees
    followed = moved.disagreement(truth, warp)
    assert followed.agrees
    assert followed.median_mm < 0.7
    assert followed.limit_mm > moved.disagreement(truth).limit_mm
    at_rest = replace(touched, model_phase=np.full(len(touched), heart.timing.fractions[heart.rest_phase]))
    distances = [
        TouchedSurface(points, heart).disagreement(truth, replace(warp.unwarped(), contraction=g)).distance_mm
        for points, g in ((at_rest, 1.0), (touched, 1.0), (touched, 0.6))
    ]
    np.testing.assert_allclose(distances[2], distances[0] + 0.6 * (distances[1] - distances[0]), atol=1e-9)


def test_too_few_points_are_refused(heart):
    rng, _, touched, start = known(heart, SEED, count=19)
    with pytest.raises(InvalidInputError, match=r"19 points were touched.*at least 20"):
        start_from_surface_points(touched, heart, np.zeros(3), rng=rng, start=start)


@pytest.mark.parametrize("shape", [[4.0, 4.0, 1.0], [40.0, 2.0, 2.0]])
def test_a_patch_and_a_line_are_refused(heart, shape):
    rng = np.random.default_rng(SEED)
    touched = TouchedPoints(Points("tracker", rng.normal(size=(40, 3)) * shape), 0.0)
    with pytest.raises(InvalidInputError, match="touch more of the surface"):
        start_from_surface_points(touched, heart, np.zeros(3), rng=rng)


def test_misuse_is_refused(heart):
    rng, truth, touched, _ = known(heart, SEED)
    with pytest.raises(InvalidInputError, match="phases of touched points"):
        TouchedPoints(touched.points, touched.model_phase[:3])
    with pytest.raises(InvalidInputError, match=r"needed 0\.05 to 10 mm"):
        TouchedPoints(touched.points, 0.0, sigma_mm=0.0)
    with pytest.raises(FrameMismatchError):
        start_from_surface_points(touched, heart, np.zeros(3), rng=rng, start=Rigid.identity("mr", "probe"))
    with pytest.raises(FrameMismatchError):
        TouchedSurface(touched, heart).disagreement(truth.inverse())


def test_missing_open3d_is_named(heart, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    rng, _, touched, start = known(heart, SEED)
    with pytest.raises(MissingDependencyError, match="Open3D"):
        start_from_surface_points(touched, heart, np.zeros(3), rng=rng, start=start)


def test_real_heart(data_dir):
    """Fitted epicardium: the front touched 40 times, 1 mm of noise, one point in ten 10 mm off."""
    folder = data_dir / "bivme-cine"
    if not folder.is_dir():
        pytest.skip(f"no fitted surfaces at {folder}")
    whole = read_surface_series(folder, "EPICARDIAL")
    phases = [0, 9]
    timing = CycleTiming(whole.timing.fractions[phases], whole.timing.rr_s)
    series = SurfaceSeries(
        whole.name, whole.frame, whole.vertices_mm[phases], whole.triangles, timing, whole.patient_id
    )
    model = model_from_surfaces(series, options=ModelOptions(knot_spacing_mm=6.0, margin_mm=10.0))
    center, targets = heart_center_mm(model), grid_targets(model)
    for seed in (SEED, SEED + 1, SEED + 2):
        rng, truth, touched, start = known(model, seed, count=40, noise_mm=1.0)
        fit = start_from_surface_points(touched, model, center, rng=rng, start=start)
        assert fit.stop is Stop.CONVERGED
        assert target_errors_mm(fit.target_from_source, truth, targets).mean() < 4.0
        assert TouchedSurface(touched, model).disagreement(fit.target_from_source).agrees
