"""The periodic blend against scipy's periodic cubic spline through the phases, and what it knows of speed."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from dvf_ig.core import CycleTiming
from dvf_ig.guidance import Evaluator, Gaussian, Sigmoid
from dvf_ig.guidance.blend import force_of_blend
from dvf_ig.guidance.evaluator import periodic_coefficients, periodic_powers
from dvf_ig.kernels.spline import spline_batch

FRACTIONS = np.array([0.05, 0.3, 0.55, 0.8])
RADII = np.array([16.0, 13.0, 14.0, 15.5])
CENTERS = np.array([[0.0, 0, 0], [2.0, 1, 0], [1.0, -1, 2], [0.5, 0, 1]])
UNEVEN = np.array([0.02, 0.11, 0.19, 0.34, 0.41, 0.6, 0.83])


def phase_fields(model, xyz):
    """(n, k, 4) distance and gradient of every phase at every point."""
    k = len(xyz)
    out = np.empty((model.phases, k, 4))
    for p in range(model.phases):
        d, g, status = np.empty(k), np.empty((k, 3)), np.empty(k, dtype=np.int64)
        spline_batch(model.coefficients, model.origin_mm, model.knot_spacing_mm, p, xyz, d, g, status)
        out[p, :, 0], out[p, :, 1:] = d, g
    return out


def through(fractions, values):
    return CubicSpline(
        np.append(fractions, fractions[0] + 1.0), np.concatenate([values, values[:1]]), bc_type="periodic"
    )


def at(spline, fractions, phi, nu=0):
    return spline(fractions[0] + (phi - fractions[0]) % 1.0, nu)


@pytest.mark.parametrize("fractions", [UNEVEN, FRACTIONS, UNEVEN[:3], UNEVEN[:2], np.arange(20) / 20])
def test_phase_weights_are_those_of_the_periodic_cubic_spline(fractions):
    timing = CycleTiming(fractions, 0.8)
    rng = np.random.default_rng(4)
    values = rng.normal(size=(len(fractions), 3))
    solved = periodic_coefficients(values.astype(np.float32)[:, None], timing)[:, 0].astype(np.float64)
    powers = periodic_powers(timing)
    spline = through(fractions, values)
    for phi in rng.uniform(size=50):
        first, _, alpha = timing.bracket(phi)
        weights = alpha ** np.arange(4) @ powers[first]
        got = sum(weights[m] * solved[(first - 1 + m) % len(fractions)] for m in range(4))
        np.testing.assert_allclose(got, at(spline, fractions, phi), atol=2e-6)
        assert weights.sum() == pytest.approx(1.0, abs=1e-12)


def test_distance_gradient_and_rate_are_those_of_the_spline_through_the_phases(ball, shell_points):
    phi = np.random.default_rng(5).uniform(-1, 2, len(shell_points))
    samples = Evaluator(ball, Sigmoid(), blend="periodic").force(shell_points, phi)
    spline = through(FRACTIONS, phase_fields(ball, shell_points))
    here = np.arange(len(phi))
    expected = at(spline, FRACTIONS, phi)[here, here]
    np.testing.assert_allclose(samples.distance_mm, expected[:, 0], atol=2e-5)
    np.testing.assert_allclose(samples.gradient, expected[:, 1:], atol=2e-5)
    np.testing.assert_allclose(
        samples.rate_mm_per_cycle, at(spline, FRACTIONS, phi, 1)[here, here, 0], atol=5e-4
    )


@pytest.mark.parametrize("law", [Sigmoid(), Gaussian(2.0, 2.0, 0.4, -1.0)])
def test_kernel_is_its_readable_twin(ball, shell_points, law):
    phi = np.random.default_rng(6).uniform(size=len(shell_points))
    samples = Evaluator(ball, law, blend="periodic").force(shell_points, phi)
    expected = force_of_blend(law, samples.distance_mm, samples.gradient)
    np.testing.assert_allclose(samples.force_n, expected, atol=1e-13)


def test_the_phases_themselves_are_kept(ball, shell_points):
    fields = phase_fields(ball, shell_points)
    evaluator = Evaluator(ball, Sigmoid(), blend="periodic")
    for p, phi in enumerate(FRACTIONS):
        np.testing.assert_allclose(evaluator.force(shell_points, phi).distance_mm, fields[p, :, 0], atol=1e-5)


def test_speed_has_no_step_at_frame_switches_unlike_the_linear_blends(ball, shell_points):
    def steps(blend):
        evaluator = Evaluator(ball, Sigmoid(), blend=blend)
        before, after = (
            evaluator.force(shell_points, FRACTIONS[1] + side).rate_mm_per_cycle for side in (-1e-7, 1e-7)
        )
        return np.abs(after - before).max()

    assert steps("periodic") < 1e-3
    assert steps("distance") > 5.0


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
def test_rate_is_the_slope_of_the_distance(ball, shell_points, blend):
    evaluator = Evaluator(ball, Sigmoid(), blend=blend)
    phi = np.random.default_rng(7).uniform(0.06, 0.29, len(shell_points))
    step = 1e-5
    ahead, behind = (evaluator.force(shell_points, phi + side).distance_mm for side in (step, -step))
    rate = evaluator.force(shell_points, phi).rate_mm_per_cycle
    np.testing.assert_allclose(rate, (ahead - behind) / (2 * step), atol=1e-5)


def test_rate_of_the_beating_ball(ball, shell_points):
    """Between two phases the linear blend moves at the difference of two closed-form distances."""
    samples = Evaluator(ball, Sigmoid()).force(shell_points, 0.42)
    first, second = (RADII[p] - np.linalg.norm(shell_points - CENTERS[p], axis=1) for p in (1, 2))
    expected = (second - first) / (FRACTIONS[2] - FRACTIONS[1])
    # each phase is fitted to 0.01 mm
    np.testing.assert_allclose(samples.rate_mm_per_cycle, expected, atol=2 * 0.01 / 0.25)
