"""The spline network of any degree, and three trainers that must meet at one minimum."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError, Stop
from dvf_ig.kernels.spline import spline_batch
from dvf_ig.preop import AxisSolver, fit_coefficients
from dvf_ig.study.training.trainers import (
    SplineAxis,
    SplineNetwork,
    safe_step,
    train_gradient,
    train_scattered,
    train_separable,
)

MIXED = SplineNetwork(SplineAxis(2, -3.0, 1.5, 4), SplineAxis(3, 1.0, 2.0, 3), SplineAxis(1, 0.0, 0.75, 5))


def positions(network, per_cell=4):
    return tuple(
        np.linspace(axis.origin_mm, axis.upper_mm, per_cell * axis.cells + 1) for axis in network.axes
    )


def on_grid(axes):
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def inside(network, rng, count):
    lower = np.array([axis.origin_mm for axis in network.axes])
    upper = np.array([axis.upper_mm for axis in network.axes])
    return rng.uniform(lower, upper, size=(count, 3))


@given(degrees=st.tuples(*[st.integers(1, 5)] * 3), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_polynomials_up_to_the_degree_are_reproduced(degrees, seed):
    rng = np.random.default_rng(seed)
    pitches, cells = (1.0, 1.5, 0.7), (3, 2, 4)
    network = SplineNetwork(
        *(SplineAxis(d, -1.0, h, n) for d, h, n in zip(degrees, pitches, cells, strict=True))
    )
    a = rng.normal(size=[d + 1 for d in degrees])
    polynomial = np.polynomial.polynomial
    samples = polynomial.polyval3d(*np.meshgrid(*positions(network, 7), indexing="ij"), a)
    trained = train_separable(network, positions(network, 7), samples)
    scale = np.abs(samples).max()
    points = inside(network, rng, 40)
    value = network.design(points) @ trained.coefficients.ravel()
    np.testing.assert_allclose(value, polynomial.polyval3d(*points.T, a), atol=1e-8 * scale)
    assert trained.rms < 1e-8 * scale


def test_cubic_network_is_what_the_kernel_evaluates():
    rng = np.random.default_rng(4)
    cells, pitch, origin = (3, 4, 5), 2.5, np.array([-4.0, 1.0, 7.0])
    network = SplineNetwork(*(SplineAxis(3, o, pitch, n) for o, n in zip(origin, cells, strict=True)))
    coefficients = rng.normal(size=network.shape).astype(np.float32)
    points = inside(network, rng, 50)
    value, gradient, status = np.empty(50), np.empty((50, 3)), np.empty(50, dtype=np.int64)
    spline_batch(coefficients[None], origin, pitch, 0, points, value, gradient, status)
    np.testing.assert_allclose(value, network.design(points) @ coefficients.ravel(), atol=1e-5)
    samples = rng.normal(size=[2 * n + 1 for n in cells])
    fast = fit_coefficients(samples, tuple(AxisSolver.of(n) for n in cells))
    general = train_separable(network, positions(network, 2), samples)
    np.testing.assert_allclose(fast, general.coefficients, atol=1e-9)


def test_three_trainers_reach_the_same_minimum():
    network = SplineNetwork(
        SplineAxis(1, -3.0, 1.5, 4), SplineAxis(2, 1.0, 2.0, 3), SplineAxis(1, 0.0, 0.75, 5)
    )
    samples = np.random.default_rng(5).normal(size=[len(x) for x in positions(network)])
    exact = train_separable(network, positions(network), samples)
    assert exact.rms > 0.5  # noise cannot be fitted: the minimum is not zero
    paper = train_gradient(network, positions(network), samples)
    scattered = train_scattered(network, on_grid(positions(network)), samples.ravel())
    assert paper.stop is scattered.stop is Stop.CONVERGED
    assert scattered.iterations < paper.iterations / 10
    np.testing.assert_allclose(paper.coefficients, exact.coefficients, atol=1e-5)
    np.testing.assert_allclose(scattered.coefficients, exact.coefficients, atol=1e-7)
    assert paper.rms == pytest.approx(exact.rms, abs=1e-9)


def test_the_safe_step_shrinks_the_error_as_the_condition_number_says():
    axes = positions(MIXED)
    design = MIXED.design(on_grid(axes)).toarray()
    step, condition = safe_step(MIXED, axes)
    eigenvalues = np.linalg.eigvalsh(design.T @ design)
    assert 1 / step == pytest.approx(eigenvalues[-1], rel=1e-9)
    assert condition == pytest.approx(eigenvalues[-1] / eigenvalues[0], rel=1e-6)
    samples = np.random.default_rng(6).normal(size=[len(x) for x in axes])
    exact = train_separable(MIXED, axes, samples).coefficients
    for steps in (10, 100, 400):
        paper = train_gradient(MIXED, axes, samples, max_iterations=steps, tolerance=0.0)
        assert paper.stop is Stop.MAX_ITERATIONS
        left = np.linalg.norm(paper.coefficients - exact)
        assert left <= (1 - 1 / condition) ** steps * np.linalg.norm(exact) * (1 + 1e-9)


def test_scattered_samples_recover_a_known_network():
    rng = np.random.default_rng(7)
    network = SplineNetwork(*(SplineAxis(d, 0.0, 1.0, 3) for d in (2, 3, 1)))
    known = rng.normal(size=network.shape)
    points = inside(network, rng, 4000)
    trained = train_scattered(network, points, network.design(points) @ known.ravel())
    np.testing.assert_allclose(trained.coefficients, known, atol=1e-6)


def test_samples_that_do_not_determine_the_network_are_refused():
    rng = np.random.default_rng(8)
    network = SplineNetwork(*(SplineAxis(3, 0.0, 1.0, 4) for _ in range(3)))
    half = inside(network, rng, 3000) * [0.5, 1, 1]
    with pytest.raises(
        InvalidInputError, match=r"98 of 343 basis functions have no samples in their support"
    ):
        train_scattered(network, half, half[:, 0])
    one_cell = SplineNetwork(*(SplineAxis(2, 0.0, 1.0, 1) for _ in range(3)))
    few = inside(one_cell, rng, 20)
    with pytest.raises(InvalidInputError, match="a known one is recovered with an error of"):
        train_scattered(one_cell, few, few[:, 0])
    sparse = (np.arange(5.0), np.linspace(0, 4, 17), np.linspace(0, 4, 17))
    with pytest.raises(InvalidInputError, match=r"leave 2 of 7 directions"):
        train_separable(network, sparse, np.zeros((5, 17, 17)))


@pytest.mark.parametrize("bad", [(0, 0.0, 1.0, 3), (6, 0.0, 1.0, 3), (3, 0.0, 0.0, 3), (3, 0.0, 1.0, 0)])
def test_axes_are_checked(bad):
    with pytest.raises(InvalidInputError):
        SplineAxis(*bad)


def test_positions_outside_are_refused():
    with pytest.raises(InvalidInputError, match="the spline is defined from 0 to 3 mm"):
        SplineAxis(3, 0.0, 1.0, 3).values(np.array([1.0, 3.1]))
