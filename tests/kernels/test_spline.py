"""The compiled spline against scipy's B-splines, and what it says outside its box."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from dvf_ig.kernels import status as code
from dvf_ig.kernels.spline import spline_batch

ORIGIN = np.array([-3.0, 10.0, 0.5])
KNOT = 2.5
SHAPE = (7, 6, 8)


def evaluate(coefficients, phase, xyz):
    n = len(xyz)
    value, gradient, status = np.empty(n), np.empty((n, 3)), np.empty(n, dtype=np.int64)
    spline_batch(coefficients, ORIGIN, KNOT, phase, xyz, value, gradient, status)
    return value, gradient, status


def axis_weights(u, count, derivative):
    """(n, count) values of all basis functions along one axis, by de Boor's recursion."""
    knots = np.arange(-3.0, count + 1.0)
    return np.stack(
        [BSpline(knots, np.eye(count)[k], 3, extrapolate=False)(u, nu=derivative) for k in range(count)],
        axis=1,
    )


def reference(coefficients, xyz):
    """Value and gradient by full sums over every coefficient."""
    u = (xyz - ORIGIN) / KNOT
    plain = [axis_weights(u[:, a], SHAPE[a], 0) for a in range(3)]
    slope = [axis_weights(u[:, a], SHAPE[a], 1) / KNOT for a in range(3)]
    c = coefficients.astype(np.float64)
    value = np.einsum("ijk,ni,nj,nk->n", c, *plain)
    gradient = [
        np.einsum("ijk,ni,nj,nk->n", c, *[slope[b] if b == a else plain[b] for b in range(3)])
        for a in range(3)
    ]
    return value, np.stack(gradient, axis=1)


@given(seed=st.integers(0, 2**32 - 1))
def test_value_and_gradient_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=(2, *SHAPE)).astype(np.float32)
    cells = np.array(SHAPE) - 3
    xyz = ORIGIN + rng.uniform(0, cells, size=(20, 3)) * 0.999999 * KNOT
    value, gradient, status = evaluate(coefficients, 1, xyz)
    expected_value, expected_gradient = reference(coefficients[1], xyz)
    assert (status == code.OK).all()
    np.testing.assert_allclose(value, expected_value, atol=1e-12)
    np.testing.assert_allclose(gradient, expected_gradient, atol=1e-12)


def test_borders_of_the_box_belong_to_it():
    coefficients = np.ones((1, *SHAPE), dtype=np.float32)
    upper = ORIGIN + (np.array(SHAPE) - 3) * KNOT
    value, gradient, status = evaluate(coefficients, 0, np.stack([ORIGIN, upper]))
    assert status.tolist() == [code.OK, code.OK]
    np.testing.assert_allclose(value, 1.0, atol=1e-12)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-12)


def test_outside_and_non_finite_points_are_distinguished():
    coefficients = np.ones((1, *SHAPE), dtype=np.float32)
    middle = ORIGIN + KNOT
    points = np.stack([middle, middle, middle, middle])
    points[0, 0] = ORIGIN[0] - 1e-6
    points[1, 2] = 1e300
    points[2, 1] = np.nan
    points[3, 0] = -np.inf
    value, gradient, status = evaluate(coefficients, 0, points)
    assert status.tolist() == [code.OUT_OF_VOLUME, code.OUT_OF_VOLUME, code.FAULT, code.FAULT]
    assert np.isnan(value).all()
    assert np.isnan(gradient).all()
