"""Pose and phase: places, rates and uncertainty, refusals, and the tick that a servo loop calls."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from readable_walls import worst_phase_forces

from dvf_ig.cardiac import retiming_curve
from dvf_ig.core import (
    FrameMismatchError,
    InvalidInputError,
    PhaseForecast,
    PhaseState,
    PoseMotion,
    RetimingCurve,
    Rigid,
)
from dvf_ig.guidance import Evaluator, Gaussian, PoseAndPhase, Sigmoid, Status
from dvf_ig.registration import PoseChart

vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
CENTER_MM = np.array([1.0, 0.0, 1.0])
POSE = Rigid.from_rotation_vector([0.4, -1.1, 0.7], [30.0, -80.0, 12.0], "mr", "tracker")
NEXT = POSE.perturbed_left([0.05, -0.08, 0.1], [3.0, -5.0, 4.0], CENTER_MM)
MOTION = PoseMotion.towards(POSE, NEXT, 10.0, CENTER_MM)
PHASE = PhaseForecast(
    since_s=9.5,
    until_s=11.2,
    state=PhaseState.LOCKED,
    state_after=PhaseState.LOST,
    phi=0.1,
    r_s=9.35,
    cycles=0.0,
    rr_s=0.8,
    spread=0.05,
    catch_up=3.0,
    r_timing_s=0.005,
)
RETIMING = retiming_curve(0.8, 1.0, 0.35, "two-segment")
ROOT = np.random.default_rng(5).normal(size=(6, 6)) * 0.2
COVARIANCE = ROOT @ ROOT.T + 0.05 * np.eye(6)
MOVING = PoseAndPhase(MOTION, PHASE, RETIMING, COVARIANCE, CENTER_MM, pose_until_s=11.1)
STILL = PoseAndPhase(PoseMotion.still(POSE), PHASE, RetimingCurve.uniform())


def tips(points):
    """Points of the model's frame where the tracker sees them before the pose moves."""
    return POSE.inverse().apply_array(points)


@given(turn=vectors, shift=vectors)
def test_the_force_turns_with_the_frame_it_is_asked_in(ball, shell_points, turn, shift):
    pose = Rigid.from_rotation_vector(turn, 40 * np.array(shift), "mr", "tracker")
    t = np.linspace(9.5, 11.2, len(shell_points))
    evaluator = Evaluator(ball, Sigmoid())
    direct = evaluator.force(shell_points, PHASE.at_many(t).phi)
    transform = PoseAndPhase(PoseMotion.still(pose), PHASE, RetimingCurve.uniform())
    through = transform.evaluate(evaluator, pose.inverse().apply_array(shell_points), t)
    assert (through.status == Status.OK).all()
    np.testing.assert_allclose(through.force_n @ pose.rotation.T, direct.force_n, atol=1e-9)
    np.testing.assert_allclose(through.gradient @ pose.rotation.T, direct.gradient, atol=1e-9)
    np.testing.assert_allclose(through.distance_mm, direct.distance_mm, atol=1e-9)


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
def test_kernel_is_its_readable_twin(ball, shell_points, blend):
    """Before, within and after the pose's motion, across the phase's wrap, and beyond what may be used."""
    evaluator = Evaluator(ball, Sigmoid(), blend=blend)
    rng = np.random.default_rng(3)
    wrap = PHASE.r_s + PHASE.rr_s
    special = [10.0, MOTION.end_s, 11.1, 11.2, 9.5, wrap, np.nextafter(wrap, 0.0), np.nan, np.inf, -np.inf]
    t = np.concatenate([special, rng.uniform(9.3, 11.4, 2000)])
    tip = tips(shell_points[rng.integers(len(shell_points), size=len(t))])
    tip[20:23] = np.nan, np.inf, -np.inf
    places, samples = MOVING.at(tip, t), MOVING.evaluate(evaluator, tip, t)
    poses = MOTION.matrices(t)
    twin = evaluator.force(places.xyz_mm, places.model_phase)
    used = places.status == Status.OK
    np.testing.assert_array_equal(samples.status, np.where(used, twin.status, places.status))
    assert set(places.status.tolist()) == {Status.OK, Status.NO_PHASE, Status.NO_POSE, Status.FAULT}
    ok = samples.status == Status.OK
    assert ok.sum() > 500

    def in_tracker(v):
        return np.einsum("nji,nj->ni", poses[ok, :, :3], v[ok])

    np.testing.assert_allclose(samples.force_n[ok], in_tracker(twin.force_n), atol=1e-12)
    np.testing.assert_allclose(samples.gradient[ok], in_tracker(twin.gradient), atol=1e-12)
    np.testing.assert_allclose(samples.distance_mm[ok], twin.distance_mm[ok], atol=1e-11)
    expected = places.distance_sigma_mm(twin.gradient, twin.rate_mm_per_cycle)
    np.testing.assert_allclose(samples.sigma_mm[ok], expected[ok], rtol=1e-10)
    none = ~ok & (samples.status != Status.NO_PHASE)
    assert not samples.force_n[none].any()
    assert np.isnan(samples.sigma_mm[none]).all()
    assert np.isnan(samples.distance_mm[none]).all()


def test_the_bound_tick_is_the_batch(ball, shell_points):
    evaluator, tip = Evaluator(ball, Sigmoid()), tips(shell_points)
    t = np.linspace(9.4, 11.3, len(tip))
    batch, places = MOVING.evaluate(evaluator, tip, t), MOVING.at(tip, t)
    gradient = np.einsum("nij,nj->ni", MOTION.matrices(t)[:, :, :3], batch.gradient)
    rate = places.distance_rate_mm_s(gradient, batch.rate_mm_per_cycle)
    tick, out = MOVING.bind(evaluator), np.empty(10)
    for k in range(0, len(tip), 7):
        assert tick(float(t[k]), tip[k], int(Status.OK), out) == batch.status[k]
        np.testing.assert_array_equal(out[:3], batch.force_n[k])
        np.testing.assert_array_equal(out[3], batch.distance_mm[k])
        np.testing.assert_array_equal(out[4:7], batch.gradient[k])
        np.testing.assert_array_equal(out[7], batch.rate_mm_per_cycle[k])
        if batch.status[k] != Status.NO_PHASE:
            np.testing.assert_allclose(out[8], rate[k], atol=1e-10)
        np.testing.assert_array_equal(out[9], batch.sigma_mm[k])


def test_rates_are_derivatives(ball):
    evaluator, step = Evaluator(ball, Sigmoid(), blend="periodic"), 1e-5
    t = np.linspace(10.01, MOTION.end_s - 0.01, 60)
    t = t[(t < 11.09) & (np.abs(PHASE.at_many(t).phi - 0.5) < 0.45)]
    tip = np.tile(tips(np.array([2.0, 3.0, 14.0])), (len(t), 1))
    before, here, after = (MOVING.at(tip, t + shift) for shift in (-step, 0.0, step))
    np.testing.assert_allclose(here.velocity_mm_s, (after.xyz_mm - before.xyz_mm) / (2 * step), atol=1e-6)
    change = (after.model_phase - before.model_phase) / (2 * step)
    np.testing.assert_allclose(here.model_phase_rate_hz, change, atol=1e-5)
    assert np.ptp(change) > 0.1
    tick, outs = MOVING.bind(evaluator), np.empty((3, 10))
    for now, point in zip(t.tolist(), tip, strict=True):
        for shift, out in zip((-step, 0.0, step), outs, strict=True):
            assert tick(now + shift, point, int(Status.OK), out) == Status.OK
        assert outs[1, 8] == pytest.approx((outs[2, 3] - outs[0, 3]) / (2 * step), abs=1e-3)


def test_the_distance_is_as_uncertain_as_pose_and_phase_make_it(ball):
    """Poses and phases drawn from their distributions give distances with that standard deviation."""
    evaluator, t_s, rng = Evaluator(ball, Sigmoid()), 9.9, np.random.default_rng(2)
    covariance = 0.02 * COVARIANCE  # small, for the distance to be linear in the pose
    transform = replace(MOVING, covariance_mm2=covariance)
    tip = tips(np.array([[4.0, 9.0, 11.0]]))
    place, found = transform.at(tip, t_s), transform.evaluate(evaluator, tip, t_s)
    chart = PoseChart(POSE, CENTER_MM)
    drawn = rng.multivariate_normal(np.zeros(6), covariance, size=4000)
    points = np.array([chart.pose(xi).apply_array(tip[0]) for xi in drawn])
    np.testing.assert_allclose(place.covariance_mm2[0], np.cov(points.T), atol=0.1 * covariance.max())
    phases = place.model_phase + place.sigma_model_phase * rng.normal(size=4000)
    spread = evaluator.force(points, phases).distance_mm.std()
    assert found.sigma_mm[0] == pytest.approx(spread, rel=0.06)
    assert np.isnan(STILL.evaluate(evaluator, tip, t_s).sigma_mm).all(), "an unknown covariance is not zero"


def test_a_withheld_pose_gives_no_force_from_its_moment_on(ball, shell_points):
    tip = tips(shell_points[:4])
    t = np.array([11.0, np.nextafter(11.1, 0.0), 11.1, 11.15])
    found = MOVING.evaluate(Evaluator(ball, Sigmoid()), tip, t)
    assert found.status.tolist() == [Status.OK, Status.OK, Status.NO_POSE, Status.NO_POSE]
    assert found.force_n[:2].any(axis=1).all()
    assert not found.force_n[2:].any()
    places = MOVING.at(tip, t)
    assert np.isnan(places.xyz_mm[2:]).all()
    assert np.isfinite(places.model_phase).all(), "phase is still known"


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"pose": None}, Status.NO_POSE),
        ({"retiming": None}, Status.NO_PHASE),
        ({"phase": replace(PHASE, state=PhaseState.SUSPECT)}, Status.NO_PHASE),
        ({"phase": replace(PHASE, until_s=9.7)}, Status.NO_PHASE),
        ({"phase": replace(PHASE, since_s=9.9)}, Status.NO_PHASE),
        ({"phase": PhaseForecast.unknown(), "retiming": None}, Status.NO_PHASE),
        ({"phase": PhaseForecast.unknown(), "pose": None}, Status.NO_POSE),
    ],
)
def test_without_pose_there_is_no_force_and_without_phase_walls_alone(ball, shell_points, change, status):
    transform, tip = replace(MOVING, **change), tips(shell_points[:3])
    places, forces = transform.at(tip, 9.8), transform.evaluate(Evaluator(ball, Sigmoid()), tip, 9.8)
    assert places.status.tolist() == forces.status.tolist() == [status] * 3
    guidance = transform.evaluate(Evaluator(ball, Gaussian()), tip, 9.8)
    assert not guidance.force_n.any()
    if status is Status.NO_POSE:
        assert not forces.force_n.any()
    else:
        walls = worst_phase_forces(Evaluator(ball, Sigmoid()), MOTION.at(9.8), tip)
        np.testing.assert_allclose(forces.force_n, walls.force_n, atol=1e-6)
        np.testing.assert_allclose(forces.distance_mm, walls.distance_mm, atol=1e-5)
        by_pose = np.einsum("nij,nj->ni", places.covariance_mm2, walls.gradient @ MOTION.at(9.8).rotation.T)
        variance = np.einsum("ni,ni->n", by_pose, walls.gradient @ MOTION.at(9.8).rotation.T)
        np.testing.assert_allclose(forces.sigma_mm, np.sqrt(variance), rtol=1e-3)
    assert np.isfinite(places.xyz_mm).all() == (transform.pose is not None)


def test_the_tool_s_status_is_kept(ball, shell_points):
    tip = tips(shell_points)[:4]
    tip[1:3] = np.nan
    given_status = np.array([Status.OK, Status.STALE_TOOL, Status.OK, Status.NO_POSE])
    samples = STILL.evaluate(Evaluator(ball, Sigmoid()), tip, 9.8, given_status)
    assert samples.status.tolist() == [Status.OK, Status.STALE_TOOL, Status.FAULT, Status.NO_POSE]
    assert (np.linalg.norm(samples.force_n, axis=1) > 0).tolist() == [True, False, False, False]


def test_the_bound_tick_leaves_what_it_was_not_given(ball):
    """Seven numbers are enough for who asks neither for rates nor for the uncertainty."""
    tick, tip = MOVING.bind(Evaluator(ball, Sigmoid())), tips(np.array([0.0, 0.0, 14.0]))
    for used in (7, 8):
        buffer = np.full(10, -1.0)
        assert tick(9.8, tip, int(Status.OK), buffer[:used]) == Status.OK
        assert (buffer[used:] == -1.0).all()


@pytest.mark.parametrize("refusal", [s for s in Status if s not in (Status.OK, Status.NO_PHASE)])
def test_the_bound_tick_passes_a_refusal_on(ball, refusal):
    out = np.ones(10)
    tick = MOVING.bind(Evaluator(ball, Sigmoid()))
    assert tick(9.8, tips(np.array([0.0, 0.0, 14.0])), int(refusal), out) == refusal
    assert not out[:3].any()
    assert np.isnan(out[3:]).all()


def test_two_ticks_do_not_share_their_pose(ball):
    evaluator, tip = Evaluator(ball, Sigmoid()), tips(np.array([0.0, 0.0, 14.0]))
    first, second, out = MOVING.bind(evaluator), MOVING.bind(evaluator), np.empty(7)
    first(9.8, tip, int(Status.OK), out)
    before = out.copy()
    second(10.9, tip, int(Status.OK), out)
    assert not np.array_equal(before, out)
    first(9.8, tip, int(Status.OK), out)
    assert np.array_equal(before, out)


def test_it_is_a_value(ball, shell_points):
    again = pickle.loads(pickle.dumps(MOVING))
    found = again.evaluate(Evaluator(ball, Sigmoid()), tips(shell_points), 10.2)
    assert np.array_equal(
        found.force_n, MOVING.evaluate(Evaluator(ball, Sigmoid()), tips(shell_points), 10.2).force_n
    )
    for array in (again.packed, again.center_mm, again.covariance_mm2):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_a_model_of_another_frame_is_refused(ball):
    elsewhere = replace(STILL, pose=PoseMotion.still(Rigid.identity("ct", "tracker")))
    with pytest.raises(FrameMismatchError, match=r"'ct'.*'mr'"):
        elsewhere.evaluate(Evaluator(ball, Sigmoid()), np.zeros((1, 3)), 9.8)
    with pytest.raises(FrameMismatchError):
        elsewhere.bind(Evaluator(ball, Sigmoid()))


def test_refusals(ball):
    evaluator = Evaluator(ball, Sigmoid())
    with pytest.raises(InvalidInputError, match="times has shape"):
        STILL.evaluate(evaluator, np.zeros((3, 3)), np.zeros(2))
    with pytest.raises(InvalidInputError, match="input status has shape"):
        STILL.evaluate(evaluator, np.zeros((3, 3)), 9.8, np.zeros(2, dtype=int))
    with pytest.raises(InvalidInputError, match="points has shape"):
        STILL.at(np.zeros(3), 9.8)
    with pytest.raises(InvalidInputError, match="covariance of the pose has shape"):
        replace(STILL, covariance_mm2=np.eye(3))
    for wrong in (-np.eye(6), np.triu(np.ones((6, 6)))):
        with pytest.raises(InvalidInputError, match="without negative eigenvalues"):
            replace(STILL, covariance_mm2=wrong)
    with pytest.raises(InvalidInputError, match="infinity for never"):
        replace(STILL, pose_until_s=math.nan)
