"""Covariance from blocks against closed forms and drawn errors; its weakest direction in words."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, InvalidInputError, Rigid
from dvf_ig.registration import Lc2, SliceSet, channels_from_mr, least_constrained_direction
from dvf_ig.registration.evidence.covariance import (
    PlacementUncertainty,
    clock_covariance_mm2,
    image_covariance_mm2,
    sandwich,
)
from dvf_ig.registration.shape.blocks import BlockedLc2

MODEL = channels_from_mr(toy_mr(), smoothing_mm=3.0)
SLICES = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)


def metric_of(slices: SliceSet) -> Lc2:
    return Lc2(slices, MODEL, patch_mm=13.0, pitch_mm=3.0)


def test_blocks_add_up_to_the_gradient_of_all_and_lie_where_they_say() -> None:
    metric = metric_of(SLICES)
    whole = metric.cost_gradient(toy_pose(), CENTER_MM)
    cut = BlockedLc2(metric, block_mm=30.0)
    aside = Rigid("mr", "tracker", np.eye(3), np.ones(3))
    _, blocks = cut.gradients([aside, toy_pose()], CENTER_MM)
    assert len(blocks.cost) > 3 * len(SLICES)
    for number in range(len(SLICES)):
        own = cut.slice == number
        np.testing.assert_allclose(blocks.cost[own].sum(), whole.cost[number], rtol=1e-9)
        np.testing.assert_allclose(
            blocks.gradient[own].sum(axis=0), whole.gradient[number], atol=1e-9 * np.abs(whole.gradient).max()
        )
    assert len(np.unique(np.column_stack([cut.slice, cut.cell]), axis=0)) == len(blocks.cost)


def test_the_sandwich_finds_the_scatter_of_a_mean_whose_errors_share_cells_and_slices() -> None:
    rng = np.random.default_rng(2)
    cell, number = (a.ravel() for a in np.meshgrid(np.arange(15), np.arange(25)))
    means, claims = [], []
    for _ in range(200):
        shared = rng.normal(size=(15, 6))[cell] + rng.normal(size=(25, 6))[number]
        errors = shared + rng.normal(size=(len(cell), 6))
        mean = errors.mean(axis=0)
        means.append(mean)
        pulls = (errors - mean) / len(cell)
        claims.append(np.diag(sandwich(pulls, np.column_stack([cell, cell, cell]), number)))
    assert np.mean(claims) == pytest.approx(np.var(means), rel=0.15)


def image_covariance(turn_rad: float, shift_mm: float) -> PlacementUncertainty:
    return PlacementUncertainty(np.diag([turn_rad**2] * 3 + [shift_mm**2] * 3), 0.01)


def test_a_shifted_image_shifts_the_pose_as_much_where_all_planes_are_parallel() -> None:
    parallel = SLICES.subset(np.zeros(6, dtype=np.int64))
    found = image_covariance_mm2(parallel, np.ones(6), toy_pose(), CENTER_MM, image_covariance(0.0, 0.7))
    np.testing.assert_allclose(found[3:, 3:], 0.49 * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(found[:3], 0.0, atol=1e-9)


def test_a_turned_image_turns_the_pose_and_shifts_it_by_its_lever() -> None:
    parallel = SLICES.subset(np.zeros(6, dtype=np.int64))
    rows, columns = SLICES.images.shape[1:]
    middle = SLICES.frame_from_pixel[0] @ np.array([(columns - 1) / 2, (rows - 1) / 2, 1.0])
    lever = float(np.linalg.norm(CENTER_MM - toy_pose().apply_array(middle[None])[0]))
    found = image_covariance_mm2(parallel, np.ones(6), toy_pose(), CENTER_MM, image_covariance(0.01, 0.0))
    np.testing.assert_allclose(np.diag(found)[:3], (0.01 * HEART_RADIUS_MM) ** 2, rtol=1e-9)
    assert np.trace(found[3:, 3:]) == pytest.approx(2 * (0.01 * lever) ** 2, rel=1e-9)


def test_a_still_heart_does_not_mind_the_clock() -> None:
    curvature: FloatArray = np.eye(6)
    pose: Rigid = toy_pose()
    found = clock_covariance_mm2(SLICES, metric_of, pose, CENTER_MM, curvature, 0.02)
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


SMALL = np.diag([(0.3 / HEART_RADIUS_MM) ** 2] * 3 + [0.3**2] * 3)


def with_sigma(turn: list[float], shift: list[float], sigma_mm: float) -> np.ndarray:
    """Covariance with `sigma_mm` along a unit (turn · radius, shift) on top of 0.3 mm everywhere."""
    worst = np.array([*np.array(turn) / HEART_RADIUS_MM, *shift])
    return SMALL + (sigma_mm**2 - 0.3**2) * np.outer(worst, worst)


def test_a_rotation_is_named() -> None:
    found = least_constrained_direction(with_sigma([0.0, 0.6, -0.8], [0, 0, 0], 1.8))
    assert found.turning
    assert found.sigma_mm == pytest.approx(1.8)
    assert found.turn_share == pytest.approx(1.0)
    np.testing.assert_allclose(found.axis, [0.0, -0.6, 0.8], atol=1e-9)
    assert found.sentence() == (
        "weakest: 1.8 mm by turning about (0.0, -0.6, 0.8); add views whose plane lies across that axis"
    )


def test_a_translation_is_named_after_its_axis() -> None:
    found = least_constrained_direction(with_sigma([0, 0, 0], [0.0, 0.0, -1.0], 2.25))
    assert not found.turning
    assert found.turn_share == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found.axis, [0, 0, 1], atol=1e-9)
    assert found.sentence().startswith("weakest: 2.2 mm along (0.0, 0.0, 1.0), superior–inferior (S–I); add")


@given(st.lists(st.floats(-1, 1), min_size=36, max_size=36), st.floats(0.1, 10))
def test_scale_and_bound(entries: list[float], scale: float) -> None:
    """Doubling every error doubles sigma; sigma is at least any coordinate's own."""
    root = np.diag([1 / HEART_RADIUS_MM] * 3 + [1.0] * 3) @ np.array(entries).reshape(6, 6)
    covariance = root @ root.T + SMALL
    found, larger = (
        least_constrained_direction(covariance),
        least_constrained_direction(scale**2 * covariance),
    )
    assert larger.sigma_mm == pytest.approx(scale * found.sigma_mm, rel=1e-6)
    own = np.sqrt(np.diag(covariance)) * ([HEART_RADIUS_MM] * 3 + [1.0] * 3)
    assert found.sigma_mm >= own.max() - 1e-9
    assert np.linalg.norm(found.axis) == pytest.approx(1.0)


def test_an_open_direction_says_so() -> None:
    found = least_constrained_direction(np.full((6, 6), np.nan))
    assert found.sigma_mm == float("inf")
    assert "leave the pose open" in found.sentence()


def test_what_is_no_covariance_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"shape \(3, 3\); needed \(6, 6\)"):
        least_constrained_direction(np.eye(3))
    with pytest.raises(InvalidInputError, match="variance of -1"):
        least_constrained_direction(np.diag([1.0, 1, 1, 1, 1, -1]))
