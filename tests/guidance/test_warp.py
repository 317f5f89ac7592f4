"""A fixture that follows a change of shape: force, gradient and rates through the warp, in every form."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.core import (
    FrameMismatchError,
    InvalidInputError,
    PhaseForecast,
    PhaseState,
    PoseMotion,
    RetimingCurve,
    Rigid,
    Warp,
    WarpMotion,
)
from dvf_ig.core.space.pose_motion import UPDATE_MM_PER_S
from dvf_ig.core.space.warp import CELLS, CONTRACTED_MM, knots
from dvf_ig.guidance import (
    Evaluator,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    PathFixture,
    PathTarget,
    PoseAndPhase,
    Sigmoid,
    Status,
)
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.servo import ServoInputs, SimulatedServo

KNOT_MM, ORIGIN_MM = 5.0, np.full(3, -30.0)
POSE = Rigid.from_rotation_vector([0.4, -1.1, 0.7], [30.0, -80.0, 12.0], "mr", "tracker")
BEAT = PhaseForecast(
    -1.0, math.inf, PhaseState.LOCKED, PhaseState.LOST, 0.1, -0.08, 0.0, 0.8, 0.05, 3.0, 0.005
)
BLENDS = ("force", "distance", "periodic")


def warp(seed, size_mm=1.0, variance_mm2=0.1):
    """A smooth change of shape, and its variance everywhere."""
    rng = np.random.default_rng(seed)
    places = knots(ORIGIN_MM, KNOT_MM)
    waves = rng.normal(scale=0.12, size=(3, 3))
    m = size_mm * np.stack([np.sin(places @ wave + rng.uniform(0.0, 6.0)) for wave in waves], axis=1)
    return Warp.through("mr", ORIGIN_MM, KNOT_MM, m, np.full(len(places), variance_mm2))


START, END = warp(1), warp(2)
MOTION = WarpMotion(START, END, 10.0, 10.5)


def through(motion, pose=POSE):
    return PoseAndPhase(PoseMotion.still(pose), BEAT, RetimingCurve.uniform(), 0.04 * np.eye(6), warp=motion)


def times_and_tips(points, n=400):
    """Times before, within and after the warp's motion, and tips around the ball's surface."""
    rng = np.random.default_rng(7)
    chosen = points[rng.integers(len(points), size=n)]
    return rng.uniform(9.8, 10.8, n), POSE.inverse().apply_array(chosen)


@pytest.mark.parametrize("blend", BLENDS)
@pytest.mark.parametrize(
    "law", [Sigmoid(1.2, 0.5), Gaussian(4.0, 1.0, 0.4, depth_mm=-1.0)], ids=["wall", "pull"]
)
def test_the_kernel_is_its_readable_twin(ball, shell_points, blend, law):
    evaluator, transform = Evaluator(ball, law, blend=blend), through(MOTION)
    t, tip = times_and_tips(shell_points)
    found, places = transform.evaluate(evaluator, tip, t), transform.at(tip, t)
    in_model = POSE.apply_array(tip)
    pull = MOTION.pull(in_model, t)
    np.testing.assert_allclose(places.xyz_mm, in_model - pull.m_mm)
    plain = evaluator.force(in_model - pull.m_mm, places.model_phase)
    ok = found.status == Status.OK
    np.testing.assert_array_equal(found.status, plain.status)
    assert ok.sum() > 300
    turn = np.eye(3) - pull.slope
    gradient = np.einsum("nji,nj->ni", turn, plain.gradient)
    norm = np.linalg.norm(gradient, axis=1)
    stretch = np.linalg.norm(plain.gradient, axis=1) / norm
    np.testing.assert_allclose(found.distance_mm[ok], (plain.distance_mm * stretch)[ok], atol=1e-5)
    np.testing.assert_allclose((found.gradient @ POSE.rotation.T)[ok], gradient[ok], atol=1e-5)
    if blend == "force":
        return  # each phase has its own stretch: next test
    sure = ok & (norm > 0.5)
    size = -law.cap_n * law.potential((plain.distance_mm / norm)[sure])
    expected = (size / norm[sure])[:, None] * gradient[sure]
    np.testing.assert_allclose((found.force_n @ POSE.rotation.T)[sure], expected, atol=1e-5)


@pytest.mark.parametrize("blend", BLENDS)
def test_gradient_and_rate_are_derivatives(ball, shell_points, blend):
    evaluator, transform = Evaluator(ball, Sigmoid(), blend=blend), through(MOTION)
    t, tip = times_and_tips(shell_points, 60)
    step = 1e-4
    here = transform.evaluate(evaluator, tip, t)
    ok = here.status == Status.OK
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        after, before = (_pulled_mm(evaluator, transform, tip + sign * shift, t) for sign in (1, -1))
        np.testing.assert_allclose(here.gradient[ok, axis], ((after - before) / (2 * step))[ok], atol=2e-3)
    if blend != "periodic":
        return  # the rate by phase has steps
    tick, out = transform.bind(evaluator), np.empty(10)
    after, before = (_pulled_mm(evaluator, transform, tip, t + sign * step) for sign in (1, -1))
    for k in np.flatnonzero(ok & (np.abs(t - 10.0) > 0.01) & (np.abs(t - 10.5) > 0.01)):
        assert tick(float(t[k]), tip[k], Status.OK, out) == Status.OK
        assert out[8] == pytest.approx((after[k] - before[k]) / (2 * step), abs=0.02)


def _pulled_mm(evaluator, transform, tip, t_s):
    """(n,) distance of the model where the warp puts tips, which is not stretched."""
    places = transform.at(tip, t_s)
    return np.array(
        [
            Evaluator(evaluator.model, evaluator.law, blend=evaluator.blend, contraction=one)
            .force(place[None], phase)
            .distance_mm[0]
            for place, phase, one in zip(
                places.xyz_mm, places.model_phase, places.contraction.tolist(), strict=True
            )
        ]
    )


@pytest.mark.parametrize("blend", BLENDS)
@pytest.mark.parametrize("contraction", [0.5, 1.3])
def test_a_heart_that_contracts_otherwise_is_its_own_model(ball, shell_points, blend, contraction):
    """At a known phase and at the worst."""
    t, tip = times_and_tips(shell_points)
    other = Evaluator(ball, Sigmoid(), blend=blend, contraction=contraction)
    evaluator, transform = Evaluator(ball, Sigmoid(), blend=blend), through(WarpMotion.still(END))
    contracting = through(WarpMotion.still(replace(END, contraction=contraction)))
    for status in (Status.OK, Status.NO_PHASE):
        given = np.full(len(t), int(status))
        found = contracting.evaluate(evaluator, tip, t, given.copy())
        expected = transform.evaluate(other, tip, t, given.copy())
        usual = transform.evaluate(evaluator, tip, t, given.copy())
        np.testing.assert_array_equal(found.status, expected.status)
        for name in ("force_n", "distance_mm", "gradient", "rate_mm_per_cycle", "sigma_mm"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=2e-5)
        assert np.nanmax(np.abs(found.distance_mm - usual.distance_mm)) > 0.1
    np.testing.assert_allclose(contracting.at(tip, t).contraction, contraction)
    at_rest = float(ball.timing.fractions[ball.rest_phase])
    here, rest = (
        Evaluator(ball, Sigmoid()).force(shell_points, phase).distance_mm for phase in (0.6, at_rest)
    )
    there = Evaluator(ball, Sigmoid(), contraction=contraction).force(shell_points, 0.6).distance_mm
    np.testing.assert_allclose(there, rest + contraction * (here - rest), atol=1e-5)


def test_a_contraction_that_changes_moves_the_wall(ball, shell_points):
    """∂d/∂t holds its part, and no wall moves faster than an update may."""
    evaluator = Evaluator(ball, Sigmoid(), blend="periodic")
    end = replace(START, contraction=0.6)
    motion = WarpMotion.towards(WarpMotion.still(START), end, 10.0)
    assert motion is not None
    assert motion.end_s == pytest.approx(10.0 + 0.4 * CONTRACTED_MM / UPDATE_MM_PER_S)
    transform, step = through(motion), 1e-4
    t, tip = times_and_tips(shell_points, 60)
    t = 10.0 + (motion.end_s - 10.0) * (t - 9.8)
    here, out = transform.evaluate(evaluator, tip, t), np.empty(10)
    tick = transform.bind(evaluator)
    within = (here.status == Status.OK) & (t < motion.end_s - 0.01) & (t > 10.01)
    before, after = (_pulled_mm(evaluator, transform, tip, t + sign * step) for sign in (-1, 1))
    for k in np.flatnonzero(within):
        assert tick(float(t[k]), tip[k], Status.OK, out) == Status.OK
        assert out[8] == pytest.approx((after[k] - before[k]) / (2 * step), abs=0.02)
    assert within.sum() > 20


def test_no_change_of_shape_changes_nothing(ball, shell_points):
    """To the bit without a warp, and to rounding with one of zero."""
    t, tip = times_and_tips(shell_points)
    zero = replace(END.unwarped())
    for blend in BLENDS:
        evaluator = Evaluator(ball, Sigmoid(), blend=blend)
        plain, warped = (through(one).evaluate(evaluator, tip, t) for one in (None, WarpMotion.still(zero)))
        np.testing.assert_allclose(warped.force_n, plain.force_n, atol=1e-9)
        np.testing.assert_allclose(warped.distance_mm, plain.distance_mm, atol=1e-9)


def test_a_wall_whose_place_is_not_known_gives_no_force_and_fades_towards_it(ball, shell_points):
    t, tip = times_and_tips(shell_points, 50)
    evaluator = Evaluator(ball, Sigmoid())
    samples = {}
    for bound_mm in (1.9, 2.2, 2.4, 2.6):
        known = warp(2, variance_mm2=(bound_mm / 1.96) ** 2)
        samples[bound_mm] = through(WarpMotion.still(known)).evaluate(evaluator, tip, t)
    size = {bound: np.linalg.norm(one.force_n, axis=1) for bound, one in samples.items()}
    ok = samples[1.9].status == Status.OK
    assert (samples[2.6].status[ok] == Status.UNSEEN).all()
    assert not size[2.6].any()
    assert (size[1.9][ok] > size[2.2][ok]).all()
    assert (size[2.2][ok] > size[2.4][ok]).all()
    assert (size[2.4][ok] > 0.0).all()


def test_a_lost_phase_leaves_the_wall_where_it_is_now(ball, shell_points):
    t, tip = times_and_tips(shell_points, 50)
    evaluator = Evaluator(ball, Sigmoid())
    lost = np.full(len(t), int(Status.NO_PHASE))
    found = through(MOTION).evaluate(evaluator, tip, t, lost)
    at = through(MOTION).at(tip, t).xyz_mm
    plain = through(None).evaluate(evaluator, POSE.inverse().apply_array(at), t, lost)
    near = np.abs(plain.distance_mm) < 2.0
    np.testing.assert_allclose(found.distance_mm[near], plain.distance_mm[near], atol=0.8)
    assert (found.status == plain.status).all()


def test_the_servo_gives_the_force_of_the_evaluator(ball, shell_points):
    """Also while the phase is lost, and when a second warp replaces the first."""
    pose = Rigid.identity("mr", "tracker")
    rate_hz, n = 1000.0, 300
    turn = np.linspace(0.0, 1.0, n)
    tip = 14.5 * np.stack([np.cos(turn), np.sin(turn), 0.2 * np.sin(3 * turn)], axis=1)
    end = replace(END, contraction=0.6)
    motions = [WarpMotion(START, end, 0.02, 0.08), WarpMotion(end, START, 0.12, 0.18)]
    fixtures = Fixtures(ball, FixtureSet((FixtureOptions(Sigmoid(1.2, 0.5), name="wall"),), cap_n=0.6))
    servo = SimulatedServo(fixtures, RecordedDevice(tip, rate_hz))
    evaluator = Evaluator(ball, Sigmoid(1.2, 0.5))
    for part, motion in enumerate(motions):
        transform = through(motion, pose)
        inputs = ServoInputs(transform, 0.1 * part, Rigid.identity("tracker", "device"))
        record = servo.run(inputs, 100)
        felt_s = record.t_s + 0.5e-3
        ahead = record.xyz_mm + 0.5e-3 * np.gradient(record.xyz_mm, 1e-3, axis=0)
        expected = transform.evaluate(evaluator, ahead, felt_s)
        assert (record.status == Status.OK).all()
        np.testing.assert_allclose(record.distance_mm[20:], expected.distance_mm[20:], atol=0.01)
        np.testing.assert_allclose(record.field_n[20:], expected.force_n[20:], atol=0.01)
        np.testing.assert_allclose(record.rows["sigma_mm"][20:], expected.sigma_mm[20:], atol=0.01)
    assert record.distance_mm.std() > 0.05


@pytest.mark.parametrize("contraction", [1.0, 0.6])
def test_a_path_moves_with_the_heart_that_has_changed_its_shape(ball, contraction):
    angle = np.linspace(0.0, 2.0, 30)
    curve = 15.0 * np.stack([np.cos(angle), np.sin(angle), 0.2 * angle], axis=1)
    size = 1.0 - 0.15 * np.sin(np.pi * ball.timing.fractions)
    law, path = Gaussian(4.0, 1.0, 0.4), PathTarget("mr", size[:, None, None] * curve, ball.timing)
    fixtures = Fixtures(ball, FixtureSet((FixtureOptions(law, path=path),)))
    turn = np.linspace(0.2, 1.6, 100)
    tip = 16.5 * np.stack([np.cos(turn), np.sin(turn), 0.2 * turn], axis=1)
    end = replace(END, contraction=contraction)
    transform = through(WarpMotion.still(end), Rigid.identity("mr", "tracker"))
    record = SimulatedServo(fixtures, RecordedDevice(tip, 1000.0)).run(
        ServoInputs(transform, 0.0, Rigid.identity("tracker", "device")), 100
    )
    felt_s = record.t_s + 0.5e-3
    ahead = record.xyz_mm + 0.5e-3 * np.gradient(record.xyz_mm, 1e-3, axis=0)
    pull, places = END.slope(ahead), transform.at(ahead, felt_s)
    at_rest = path.points_mm[ball.rest_phase]
    now = replace(path, points_mm=at_rest + contraction * (path.points_mm - at_rest))
    plain = PathFixture(now, law).force(places.xyz_mm, places.model_phase)
    expected = np.einsum("nji,nj->ni", np.eye(3) - pull, plain.force_n)
    np.testing.assert_allclose(record.field_n[20:-1], expected[20:-1], atol=2e-3)
    assert np.linalg.norm(expected, axis=1).max() > 0.1


def test_a_warp_that_is_carried_to_another_pose_leaves_the_walls_where_they_are():
    pose = POSE.perturbed_left([0.01, -0.02, 0.015], [0.5, -0.4, 0.3], np.zeros(3))
    tracker = POSE.inverse().apply_array(np.random.default_rng(3).uniform(-15.0, 15.0, (50, 3)))
    first, second = POSE.apply_array(tracker), pose.apply_array(tracker)
    gentle = warp(2, size_mm=0.3)
    carried = gentle.at_pose(POSE, pose)
    np.testing.assert_allclose(second - carried.at(second)[0], first - gentle.at(first)[0], atol=0.1)
    assert np.abs(second - first).max() > 0.5
    still = replace(END, coefficients=np.zeros_like(END.coefficients)).at_pose(POSE, pose)
    np.testing.assert_allclose(second - still.at(second)[0], first, atol=1e-4)


def test_a_motion_is_linear_and_keeps_its_ends():
    assert MOTION.at(9.0) is not END
    np.testing.assert_array_equal(MOTION.at(9.0).coefficients, START.coefficients)
    assert MOTION.at(10.5) is END
    middle = 0.5 * (START.coefficients + END.coefficients)
    np.testing.assert_allclose(MOTION.at(10.25).coefficients, middle, atol=1e-6)
    assert END.steepest == pytest.approx(
        np.linalg.norm(END.slope(knots(ORIGIN_MM, 2.5, 24)), ord=2, axis=(1, 2)).max(), rel=0.1
    )


def test_what_does_not_fit_is_refused():
    with pytest.raises(FrameMismatchError):
        through(WarpMotion.still(replace(END, frame="ct")))
    with pytest.raises(InvalidInputError):
        WarpMotion(START, replace(END, knot_mm=6.0), 0.0, 1.0)
    with pytest.raises(InvalidInputError):
        replace(END, coefficients=END.coefficients[:CELLS])
    with pytest.raises(InvalidInputError):
        replace(END, coefficients=np.nan * END.coefficients)
