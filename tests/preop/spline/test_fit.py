"""Separable least squares: exact on cubics, and the true minimum of the paper's quadratic."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError
from dvf_ig.kernels.spline import spline_batch
from dvf_ig.preop import AxisSolver, fit_coefficients
from dvf_ig.preop.spline import fit as spline_fit
from dvf_ig.preop.spline.fit import cubic_basis, fit_weighted, surface_weights

CELLS = (4, 5, 6)
SOLVERS = tuple(AxisSolver.of(n) for n in CELLS)


def lattice():
    axes = [np.arange(2 * n + 1) / 2 for n in CELLS]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


@given(seed=st.integers(0, 2**32 - 1))
def test_cubic_polynomials_are_reproduced_with_their_gradient(seed):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(4, 4, 4))

    def polynomial(q, derivative=(0, 0, 0)):
        b: np.ndarray = a
        for axis, order in enumerate(derivative):
            for _ in range(order):
                b = np.polynomial.polynomial.polyder(b, axis=axis)
        return np.polynomial.polynomial.polyval3d(*np.moveaxis(q, -1, 0), b)

    coefficients = fit_coefficients(polynomial(lattice()), SOLVERS)
    points = rng.uniform(0, CELLS, size=(30, 3))
    value, gradient, status = np.empty(30), np.empty((30, 3)), np.empty(30, dtype=np.int64)
    spline_batch(coefficients[None].astype(np.float32), np.zeros(3), 1.0, 0, points, value, gradient, status)
    scale = np.abs(polynomial(lattice())).max()
    np.testing.assert_allclose(value, polynomial(points), atol=1e-5 * scale)
    for axis in range(3):
        order = tuple(int(axis == k) for k in range(3))
        np.testing.assert_allclose(gradient[:, axis], polynomial(points, order), atol=1e-5 * scale)


def test_the_fit_is_the_full_least_squares_minimum():
    samples = np.random.default_rng(3).normal(size=[2 * n + 1 for n in CELLS])
    got = fit_coefficients(samples, SOLVERS)
    x, y, z = (cubic_basis(n).dense() for n in CELLS)
    full = np.kron(x, np.kron(y, z))
    expected = np.linalg.lstsq(full, samples.ravel(), rcond=None)[0]
    np.testing.assert_allclose(got.ravel(), expected, atol=1e-9)


def test_the_weighted_fit_is_the_weighted_minimum(monkeypatch):
    monkeypatch.setattr(spline_fit, "TOLERANCE", 1e-8)
    monkeypatch.setattr(spline_fit, "MAX_ITERATIONS", 400)
    rng = np.random.default_rng(4)
    samples = rng.normal(size=[2 * n + 1 for n in CELLS])
    weights = rng.uniform(0.05, 1.0, size=samples.shape)
    got = fit_weighted(samples, weights, SOLVERS)
    x, y, z = (cubic_basis(n).dense() for n in CELLS)
    root = np.sqrt(weights).ravel()
    full = np.kron(x, np.kron(y, z)) * root[:, None]
    expected = np.linalg.lstsq(full, root * samples.ravel(), rcond=None)[0]
    np.testing.assert_allclose(got.ravel(), expected, rtol=1e-6, atol=1e-5)


def test_equal_weights_change_nothing():
    samples = np.random.default_rng(5).normal(size=[2 * n + 1 for n in CELLS])
    got = fit_weighted(samples, np.full(samples.shape, 0.3), SOLVERS)
    np.testing.assert_allclose(got, fit_coefficients(samples, SOLVERS), atol=1e-9)


def test_weights_bring_the_zero_level_of_a_kinked_map_closer():
    """|x| − 3/2 has its crease half a knot from a sample; the wanted zeros are at ±3/2 knots."""
    u = lattice()[..., 0] - 2.25
    samples = np.abs(u) - 1.5
    at = np.array([[0.75, 2.0, 3.0], [3.75, 2.0, 3.0]])

    def zero_error(coefficients):
        value, gradient, status = np.empty(2), np.empty((2, 3)), np.empty(2, dtype=np.int64)
        one = coefficients[None].astype(np.float32)
        spline_batch(one, np.zeros(3), 1.0, 0, at, value, gradient, status)
        return np.abs(value).max()

    plain = zero_error(fit_coefficients(samples, SOLVERS))
    first = zero_error(fit_weighted(samples, surface_weights(samples, 1.0), SOLVERS))
    assert first < 0.5 * plain


def test_weights_are_checked():
    samples = np.zeros([2 * n + 1 for n in CELLS])
    for bad in (np.zeros_like(samples), np.full_like(samples, np.nan), np.ones(3)):
        with pytest.raises(InvalidInputError, match="every weight positive"):
            fit_weighted(samples, bad, SOLVERS)
