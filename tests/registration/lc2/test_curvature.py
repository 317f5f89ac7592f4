"""Gradient and curvature of the cost against differences of the score, and closed forms of what follows."""

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import FloatArray, Grid, Rigid
from dvf_ig.registration import Lc2, ModelChannels, PoseChart, channels_from_mr
from dvf_ig.registration.lc2.curvature import STEP_MM, Curvature, curvature_about
from dvf_ig.registration.lc2.optimise import OptimiserOptions, optimise

AWAY = np.array([2.0, -1.0, 1.5, 1.0, -2.0, 1.5])


def whole_model(smoothing_mm: float) -> ModelChannels:
    return channels_from_mr(toy_mr(), smoothing_mm=smoothing_mm)


def cut_model(smoothing_mm: float) -> ModelChannels:
    """The middle of the same, so that walls and blood reach its border and most of each slice lies beyond."""
    model, low, high = whole_model(smoothing_mm), (14, 10, 16), (52, 50, 58)
    values = model.values[:, low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    first = model.grid.to_mm(np.array(low, dtype=np.float64))
    shape = (high[0] - low[0], high[1] - low[1], high[2] - low[2])
    grid = Grid.axis_aligned("mr", shape, first, model.grid.spacing_mm)
    return ModelChannels(grid, np.ascontiguousarray(values), model.fractions)


def metric(model: ModelChannels, speckle: float = 0.1) -> Lc2:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=speckle)
    return Lc2(slices, model, patch_mm=13.0, pitch_mm=3.0)


def cost(lc2: Lc2, pose: Rigid) -> FloatArray:
    """(s,) Σ w(1 − S), from the score's own kernel."""
    out = lc2.per_slice(pose)
    return np.asarray(out[:, 1] - out[:, 0])


@pytest.mark.parametrize(("model", "most_overlap"), [(whole_model(3.0), 1.0), (cut_model(3.0), 0.45)])
def test_gradient_of_each_slice_is_that_of_the_score_also_beyond_the_model(
    model: ModelChannels, most_overlap: float
) -> None:
    lc2, chart = metric(model), PoseChart(PoseChart(toy_pose(), CENTER_MM).pose(AWAY), CENTER_MM)
    assert 0.35 < lc2.score(chart.base).overlap < most_overlap
    found, step = lc2.cost_gradient(chart.base, CENTER_MM), 1e-4
    np.testing.assert_allclose(found.cost, cost(lc2, chart.base), rtol=1e-9)
    expected = np.empty_like(found.gradient)
    for i, xi in enumerate(step * np.eye(6)):
        expected[:, i] = (cost(lc2, chart.pose(xi)) - cost(lc2, chart.pose(-xi))) / (2 * step)
    # trilinear channels bend at voxel faces, which a pixel in some ten thousand crosses within such a step
    np.testing.assert_allclose(found.gradient, expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("model", [whole_model(3.0), cut_model(3.0)])
def test_hessian_is_that_of_the_score(model: ModelChannels) -> None:
    lc2 = metric(model)
    chart = PoseChart(
        optimise(lc2, toy_pose(), CENTER_MM, None, OptimiserOptions(30, 2.0, 0.01)).pose, CENTER_MM
    )
    found = curvature_about(lc2, chart)

    def slope_of_score(about: Rigid) -> FloatArray:
        local, step = PoseChart(about, CENTER_MM), 1e-4 * np.eye(6)
        ahead, behind = ([cost(lc2, local.pose(s * xi)).sum() for xi in step] for s in (1, -1))
        return (np.array(ahead) - behind) / 2e-4

    ends = [[slope_of_score(chart.pose(s * xi)) for xi in STEP_MM * np.eye(6)] for s in (1, -1)]
    expected = np.subtract(*ends) / (2 * STEP_MM)
    expected = 0.5 * (expected + expected.T)
    np.testing.assert_allclose(found.hessian, expected, atol=2e-3 * np.abs(expected).max())
    assert np.linalg.eigvalsh(found.hessian).min() > 0
    np.testing.assert_array_equal(found.gradient, lc2.cost_gradient(chart.base, CENTER_MM).gradient)


def bowls(centers: FloatArray, weights: FloatArray, matrix: FloatArray) -> Curvature:
    """Curvature at ξ = 0 of slices with costs of one shape, quadratic about optima (s, 6) of their own."""
    shares = weights / weights.sum()
    gradient = -shares[:, None] * (centers @ matrix)
    return Curvature(PoseChart(toy_pose(), CENTER_MM), weights, gradient, matrix)


def test_the_curvature_is_that_of_the_likelihood() -> None:
    information, weights, stiff = 90.0, np.array([1.5, 2.5]), 3.0
    found = bowls(np.zeros((2, 6)), weights, stiff * np.eye(6))
    # −n/2·log(1 − S) with 1 − S ∝ Σ w(1 − S): its curvature is n/2 of the cost's over the cost
    expected = information * stiff / (2.0 * weights.sum()) * np.eye(6)
    np.testing.assert_allclose(found.scaled(information), expected, rtol=1e-12)
