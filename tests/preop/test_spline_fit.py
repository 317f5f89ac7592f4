"""Separable least squares: exact on cubics, and the true minimum of the paper's quadratic."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.kernels.spline import spline_batch
from dvf_ig.preop import AxisSolver, fit_coefficients
from dvf_ig.preop.spline_fit import cubic_basis

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
        b = a
        for axis, order in enumerate(derivative):
            for _ in range(order):
                b = np.polynomial.polynomial.polyder(b, axis=axis)
        return np.polynomial.polynomial.polyval3d(*np.moveaxis(q, -1, 0), b)

    coefficients = fit_coefficients(polynomial(lattice()), SOLVERS)
    points = rng.uniform(0, CELLS, size=(30, 3))
    value, gradient, status = np.empty(30), np.empty((30, 3)), np.empty(30, dtype=np.int64)
    spline_batch(coefficients[None], np.zeros(3), 1.0, 0, points, value, gradient, status)
    scale = np.abs(polynomial(lattice())).max()
    np.testing.assert_allclose(value, polynomial(points), atol=1e-9 * scale)
    for axis in range(3):
        order = tuple(int(axis == k) for k in range(3))
        np.testing.assert_allclose(gradient[:, axis], polynomial(points, order), atol=1e-8 * scale)


def test_the_fit_is_the_full_least_squares_minimum():
    samples = np.random.default_rng(3).normal(size=[2 * n + 1 for n in CELLS])
    got = fit_coefficients(samples, SOLVERS)
    x, y, z = (cubic_basis(n).toarray() for n in CELLS)
    full = np.kron(x, np.kron(y, z))
    expected = np.linalg.lstsq(full, samples.ravel(), rcond=None)[0]
    np.testing.assert_allclose(got.ravel(), expected, atol=1e-9)
