"""Force laws: values, steepest points, and what a device refuses."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import Confinement, DeviceLimits, Evaluator, Gaussian, Sigmoid, Status
from dvf_ig.guidance.laws import gaussian_steepness


def steepest(law, reach_mm):
    d = np.linspace(-reach_mm, reach_mm, 40_001)
    return law.cap_n * np.abs(np.diff(law.potential(d))).max() / (d[1] - d[0])


@given(st.floats(0.1, 4.0), st.floats(0.1, 2.0), st.floats(-5.0, 5.0))
def test_sigmoid_is_half_its_cap_at_the_guarded_depth_and_rises_inwards(gamma, cap, depth):
    law = Sigmoid(gamma, cap, depth)
    assert law.potential(np.array([depth]))[0] == pytest.approx(0.5)
    assert (np.diff(law.potential(np.linspace(-9, 9, 50))) >= 0).all()


@given(st.floats(0.2, 10.0), st.sampled_from([0.5, 1.0, 2.0, 3.0]), st.floats(-5.0, 5.0))
def test_gaussian_is_odd_about_its_target(delta, m, depth):
    law = Gaussian(delta, m, 0.6, depth)
    s = np.linspace(0, 20, 50)
    np.testing.assert_allclose(law.potential(depth + s), -law.potential(depth - s), atol=1e-12)
    assert law.potential(np.array([depth]))[0] == 0.0


@given(st.floats(0.1, 4.0), st.floats(0.1, 2.0))
def test_sigmoid_stiffness_is_its_steepest_slope(gamma, cap):
    law = Sigmoid(gamma, cap)
    assert steepest(law, 10.0) == pytest.approx(law.stiffness_n_per_mm, rel=1e-4)


@pytest.mark.parametrize(("m", "c"), [(0.5, 1.0), (1.0, 0.858), (2.0, 1.523), (3.0, 2.240), (4.0, 2.967)])
def test_gaussian_stiffness_is_its_steepest_slope(m, c):
    law = Gaussian(2.5, m)
    assert law.stiffness_n_per_mm == pytest.approx(steepest(law, 10.0), rel=1e-3)
    assert law.stiffness_n_per_mm * law.delta_mm / law.cap_n == pytest.approx(c, abs=1.5e-3)


@given(st.floats(0.5, 20.0))
def test_both_forms_of_the_steepness_are_one(m):
    """c_m = n·u^u·e^(−u) with u = (n−1)/n (docs/theory/fixtures.md)."""
    n = 2 * m
    u = (n - 1) / n
    assert gaussian_steepness(m) == pytest.approx(n * u ** (1 - 1 / n) * math.exp(-u), rel=1e-12)


@given(st.floats(0.1, 4.0), st.floats(-5.0, 5.0))
def test_confinement_is_a_sigmoid_of_the_negated_field(gamma, depth):
    d = np.linspace(-9, 9, 50)
    confined, free = Confinement(gamma, 0.6, depth), Sigmoid(gamma, 0.6, depth)
    np.testing.assert_allclose(confined.potential(d), -free.potential(-d), atol=1e-15)
    assert confined.stiffness_n_per_mm == free.stiffness_n_per_mm


@pytest.mark.parametrize("blend", ["force", "distance"])
def test_confinement_pushes_back_into_the_chamber(ball, shell_points, blend):
    """Inside and out, towards the centre, harder the further out; full depth inside, next to nothing."""
    samples = Evaluator(ball, Confinement(2.0, 0.6, 1.0), blend=blend).force(
        shell_points, ball.timing.fractions[0]
    )
    radius = np.linalg.norm(shell_points, axis=1)
    expected = -0.6 / (1 + np.exp(-2.0 * (radius - 16.0 - 1.0)))[:, None] * shell_points / radius[:, None]
    assert (samples.status == Status.OK).all()
    np.testing.assert_allclose(samples.force_n, expected, atol=0.008)


def test_flat_gaussian_has_no_stiffness_bound():
    assert math.isinf(Gaussian(2.0, 0.3).stiffness_n_per_mm)


def test_free_zone_is_felt_at_its_border_only():
    law = Gaussian.with_free_zone(2.0, 0.05, m=2.0, cap_n=0.6)
    assert 0.6 * law.potential(np.array([2.0]))[0] == pytest.approx(0.05)
    with pytest.raises(InvalidInputError, match="between 0 and the cap"):
        Gaussian.with_free_zone(2.0, 0.7)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Sigmoid(0.0),
        lambda: Sigmoid(1.0, -0.1),
        lambda: Sigmoid(1.0, 0.6, math.nan),
        lambda: Confinement(-1.0),
        lambda: Confinement(1.0, 0.0),
        lambda: Gaussian(-1.0),
        lambda: Gaussian(1.0, 0.0),
        lambda: Gaussian(1.0, 1.0, math.inf),
        lambda: DeviceLimits(rate_hz=0.0),
        lambda: DeviceLimits(stiffness_n_per_m=math.nan),
    ],
)
def test_senseless_numbers_are_refused(make):
    with pytest.raises(InvalidInputError):
        make()


def test_stiffness_cap_is_the_published_gamma():
    limits = DeviceLimits(stiffness_n_per_m=400.0)
    assert limits.checked(Sigmoid(2.66)).gamma_per_mm == 2.66
    with pytest.raises(
        InvalidInputError, match=r"405 N/m at its steepest, at most 400 N/m .*gamma_per_mm <= 2.667"
    ):
        limits.checked(Sigmoid(2.7))
    with pytest.raises(InvalidInputError, match=r"delta_mm >= 1\.287"):
        limits.checked(Gaussian(1.0, 1.0))
    with pytest.raises(InvalidInputError, match="unbounded"):
        limits.checked(Gaussian(1.0, 0.4))


def test_passivity_bound_of_a_sampled_wall():
    """γ ≤ 8(b − |B|)/(F·T) with b, B in N·s/mm."""
    limits = DeviceLimits(rate_hz=1000.0, damping_n_s_per_m=0.1, virtual_damping_n_s_per_m=0.02)
    gamma = 8 * (0.1e-3 - 0.02e-3) / (0.6 * 1e-3)
    limits.checked(Sigmoid(0.999 * gamma))
    with pytest.raises(InvalidInputError, match="passivity"):
        limits.checked(Sigmoid(1.001 * gamma))
    with pytest.raises(InvalidInputError, match="lower the virtual damping"):
        DeviceLimits(damping_n_s_per_m=0.1, virtual_damping_n_s_per_m=0.1).checked(Sigmoid())
