"""The evaluator against closed forms and its NumPy reference; continuity; what it refuses to push with."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import DvfModel, FrameMismatchError, InvalidInputError, Rigid
from dvf_ig.guidance import DeviceLimits, Evaluator, Gaussian, Sigmoid, Status, static_force
from dvf_ig.guidance.blend import blend_distances, blend_forces
from dvf_ig.kernels.dynamic import force_tick
from dvf_ig.kernels.spline import spline_batch

CENTERS = np.array([[0.0, 0, 0], [2.0, 1, 0], [1.0, -1, 2], [0.5, 0, 1]])
RADII = np.array([16.0, 13.0, 14.0, 15.5])
POSE = Rigid.from_rotation_vector([0.4, -1.1, 0.7], [30.0, -80.0, 12.0], "mr", "tracker")
LAWS = [Sigmoid(), Sigmoid(2.0, 0.5, 1.0), Gaussian(3.0, 1.0), Gaussian(2.0, 2.0, 0.4, -1.0)]


def field(model: DvfModel, phase: int, xyz):
    n = len(xyz)
    d, g, status = np.empty(n), np.empty((n, 3)), np.empty(n, dtype=np.int64)
    spline_batch(model.coefficients, model.origin_mm, model.knot_spacing_mm, phase, xyz, d, g, status)
    return d, g


def reference(evaluator: Evaluator, xyz, phi):
    """The readable form, point by point."""
    out = []
    for point, at in zip(xyz, phi, strict=True):
        first, second, alpha = evaluator.model.timing.bracket(at)
        a, b = (field(evaluator.model, p, point[None]) for p in (first, second))
        weight = np.array([alpha])
        if evaluator.blend == "distance":
            out.append(blend_distances(evaluator.law, a, b, weight)[0])
        else:
            forces = (static_force(evaluator.law, *a), static_force(evaluator.law, *b))
            out.append(blend_forces(*forces, weight)[0])
    return np.array(out)


@pytest.mark.parametrize("phase", range(4))
def test_at_a_phase_the_force_is_that_of_the_sphere(ball, shell_points, phase):
    samples = Evaluator(ball, Sigmoid()).force(shell_points, ball.timing.fractions[phase])
    outward = shell_points - CENTERS[phase]
    radius = np.linalg.norm(outward, axis=1)
    depth = RADII[phase] - radius
    expected = 0.6 / (1 + np.exp(-depth[:, None])) * outward / radius[:, None]
    assert (samples.status == Status.OK).all()
    np.testing.assert_allclose(samples.distance_mm, depth, atol=0.01)
    np.testing.assert_allclose(samples.gradient, -outward / radius[:, None], atol=0.02)
    np.testing.assert_allclose(samples.force_n, expected, atol=0.004)


@pytest.mark.parametrize("blend", ["force", "distance"])
@pytest.mark.parametrize("law", LAWS)
def test_kernel_is_its_readable_twin(ball, shell_points, law, blend):
    evaluator = Evaluator(ball, law, blend=blend)
    phi = np.random.default_rng(2).uniform(-1, 2, size=len(shell_points))
    got = evaluator.force(shell_points, phi).force_n
    np.testing.assert_allclose(got, reference(evaluator, shell_points, phi), atol=1e-12)


@given(
    seed=st.integers(0, 2**32 - 1),
    law=st.sampled_from(LAWS),
    blend=st.sampled_from(["force", "distance", "periodic"]),
)
def test_force_never_exceeds_its_cap(ball, seed, law, blend):
    rng = np.random.default_rng(seed)
    samples = Evaluator(ball, law, blend=blend).force(
        rng.uniform(-35, 35, size=(50, 3)), rng.uniform(size=50)
    )
    assert np.isfinite(samples.force_n).all()
    assert np.linalg.norm(samples.force_n, axis=1).max() <= law.cap_n * (1 + 1e-12)
    assert not samples.force_n[samples.status != Status.OK].any()


def jumps(force, phi_of_switch, points):
    """Largest change of force over 2e-9 of a cycle, at each frame switch."""
    step = 1e-9
    return [
        np.linalg.norm(force(points, phi + step) - force(points, phi - step), axis=1).max()
        for phi in phi_of_switch
    ]


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
def test_force_is_continuous_across_frame_switches_and_the_cycle_s_end(ball, shell_points, blend):
    evaluator = Evaluator(ball, Sigmoid(), blend=blend)
    switches = [*ball.timing.fractions, 0.0, 1.0]
    assert max(jumps(lambda q, phi: evaluator.force(q, phi).force_n, switches, shell_points)) < 1e-7


def test_eq_10_as_printed_jumps_at_every_frame_switch(ball, shell_points):
    """F = αF(V_i) + (1−α)F(V_{i+1}) beside the corrected (1−α)F(V_i) + αF(V_{i+1})."""
    law = Sigmoid()

    def blended(weights_of):
        def force(points, phi):
            first, second, alpha = ball.timing.bracket(phi)
            a, b = (static_force(law, *field(ball, p, points)) for p in (first, second))
            v, w = weights_of(alpha)
            return v * a + w * b

        return force

    printed = blended(lambda alpha: (alpha, 1 - alpha))
    corrected = blended(lambda alpha: (1 - alpha, alpha))
    switches = ball.timing.fractions
    assert min(jumps(printed, switches, shell_points)) > 0.25
    assert max(jumps(corrected, switches, shell_points)) < 1e-7
    at_second = static_force(law, *field(ball, 2, shell_points))
    np.testing.assert_allclose(printed(shell_points, switches[1]), at_second, atol=1e-9)


def test_blended_distance_is_corrected_for_its_shrunken_gradient(ball):
    """Half way between two phases whose normals differ, |∇d| < 1, and the law is given d/|∇d|."""
    phi = 0.5 * (ball.timing.fractions[0] + ball.timing.fractions[1])
    point = np.array([[0.0, 8.0, 0.0]])
    samples = Evaluator(ball, Sigmoid(), blend="distance").force(point, phi)
    norm = np.linalg.norm(samples.gradient[0])
    assert norm < 0.999
    expected = 0.6 / (1 + np.exp(-samples.distance_mm[0] / norm))
    assert np.linalg.norm(samples.force_n[0]) == pytest.approx(expected)


def test_no_force_where_the_direction_is_lost(ball):
    """At the centre of the ball the gradient vanishes; the force fades instead of flipping."""
    evaluator = Evaluator(ball, Sigmoid())
    along = np.linspace(-6, 6, 2401)[:, None] * np.array([1.0, 0.2, 0.1])
    samples = evaluator.force(along, ball.timing.fractions[0])
    norm = np.linalg.norm(samples.gradient, axis=1)
    lost = norm < 0.2
    assert lost.any()
    assert not samples.force_n[lost].any()
    assert np.linalg.norm(np.diff(samples.force_n, axis=0), axis=1).max() < 0.02


def test_outside_the_box_and_faulty_numbers_get_no_force_and_say_so(ball):
    points = np.array([[0.0, 0, 15], [100.0, 0, 0], [np.nan, 0, 0], [0.0, 0, np.inf], [0.0, 0, 15]])
    samples = Evaluator(ball, Sigmoid()).force(points, np.array([0.1, 0.1, 0.1, 0.1, np.nan]))
    assert [Status(s) for s in samples.status] == [
        Status.OK,
        Status.OUT_OF_VOLUME,
        Status.FAULT,
        Status.FAULT,
        Status.FAULT,
    ]
    assert not samples.force_n[1:].any()
    assert np.isnan(samples.distance_mm[1:]).all()


def test_wrong_shapes_and_blends_are_refused(ball):
    evaluator = Evaluator(ball, Sigmoid())
    with pytest.raises(InvalidInputError, match=r"points has shape \(3,\)"):
        evaluator.force(np.zeros(3), 0.1)
    with pytest.raises(InvalidInputError, match=r"model phase has shape \(2,\)"):
        evaluator.force(np.zeros((3, 3)), np.zeros(2))
    with pytest.raises(InvalidInputError, match="choose one of force, distance, periodic"):
        Evaluator(ball, Sigmoid(), blend="nearest")


def test_a_law_beyond_the_device_is_refused_at_construction(ball):
    with pytest.raises(InvalidInputError, match="450 N/m at its steepest"):
        Evaluator(ball, Sigmoid(3.0))
    allowed = Evaluator(ball, Sigmoid(3.0), device=DeviceLimits(stiffness_n_per_m=1000.0))
    assert allowed.law == Sigmoid(3.0)


def test_through_a_map_the_force_is_that_of_the_mapped_points(ball, shell_points):
    evaluator, phi = Evaluator(ball, Sigmoid()), np.linspace(0, 1, len(shell_points))
    direct = evaluator.force(shell_points, phi)
    through = evaluator.force_through(POSE, POSE.inverse().apply_array(shell_points), phi)
    np.testing.assert_allclose(through.force_n @ POSE.rotation.T, direct.force_n, atol=1e-9)
    np.testing.assert_allclose(through.gradient @ POSE.rotation.T, direct.gradient, atol=1e-9)
    assert (direct.frame, through.frame) == ("mr", "tracker")
    with pytest.raises(FrameMismatchError, match=r"'ct'.*'mr'"):
        evaluator.force_through(Rigid.identity("ct", "tracker"), shell_points, phi)


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
def test_a_tick_is_the_batch(ball, shell_points, blend):
    tip = POSE.inverse().apply_array(shell_points)
    evaluator = Evaluator(ball, Sigmoid(), blend=blend)
    batch = evaluator.force_through(POSE, tip, 0.7)
    tick, out = partial(force_tick, *evaluator.kernel_arguments(POSE)), np.empty(8)
    for k in range(0, len(tip), 17):
        assert tick(tip[k], 0.7, int(Status.OK), out) == Status.OK
        assert np.array_equal(out[:3], batch.force_n[k])
        assert out[3] == batch.distance_mm[k]
        assert np.array_equal(out[4:7], batch.gradient[k])
        assert out[7] == batch.rate_mm_per_cycle[k]


def test_no_force_where_the_input_is_not_valid(ball, shell_points):
    tip, evaluator = POSE.inverse().apply_array(shell_points), Evaluator(ball, Sigmoid())
    given_status = np.where(np.arange(len(tip)) % 3 == 0, Status.OK, Status.STALE_TOOL)
    tip[given_status != Status.OK] = np.nan
    samples = evaluator.force_through(POSE, tip, 0.2, given_status)
    np.testing.assert_array_equal(samples.status, given_status)
    assert not samples.force_n[given_status != Status.OK].any()
    tick, out = partial(force_tick, *evaluator.kernel_arguments(POSE)), np.ones(7)
    for refusal in [s for s in Status if s not in (Status.OK, Status.NO_PHASE)]:
        assert tick(tip[0], 0.1, int(refusal), out) == refusal
        assert not out[:3].any()
        assert np.isnan(out[3:]).all()
