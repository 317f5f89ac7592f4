"""Covariance intersection: closed forms, and estimates whose shared error is known."""

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_pose

from dvf_ig.core import FloatArray
from dvf_ig.registration import PoseChart, PoseEstimate
from dvf_ig.registration.tracking.covariance_intersection import covariance_intersection


def estimate(offset_mm: FloatArray, covariance: FloatArray) -> PoseEstimate:
    return PoseEstimate(PoseChart(toy_pose(), CENTER_MM).pose(offset_mm), covariance, CENTER_MM)


def test_the_same_estimate_twice_is_no_better_than_once() -> None:
    covariance = np.diag([1.0, 2.0, 1.0, 0.5, 1.0, 3.0])
    fused = covariance_intersection(estimate(np.zeros(6), covariance), estimate(np.zeros(6), covariance))
    np.testing.assert_allclose(fused.covariance_mm2, covariance, rtol=1e-9)


def test_the_better_estimate_of_two_alike_is_taken() -> None:
    good, bad = estimate(np.zeros(6), np.eye(6)), estimate(np.full(6, 0.5), 9.0 * np.eye(6))
    for fused in (covariance_intersection(good, bad), covariance_intersection(bad, good)):
        np.testing.assert_allclose(fused.covariance_mm2, np.eye(6), rtol=1e-6)
        np.testing.assert_allclose(fused.pose.matrix, good.pose.matrix, atol=1e-6)


def test_estimates_that_know_different_directions_help_each_other() -> None:
    one, other = np.diag([1.0] * 3 + [100.0] * 3), np.diag([100.0] * 3 + [1.0] * 3)
    fused = covariance_intersection(estimate(np.zeros(6), one), estimate(np.zeros(6), other))
    assert np.trace(fused.covariance_mm2) < 0.05 * np.trace(one)


def test_a_shared_error_is_not_claimed_away() -> None:
    """Two estimates with one common error: fused as independent they would claim half the variance."""
    rng = np.random.default_rng(1)
    own, covariance, claims = 0.3, (1.0 + 0.09) * np.eye(6), []
    for _ in range(100):
        shared = rng.normal(size=6)
        one, other = (estimate(shared + own * rng.normal(size=6), covariance) for _ in range(2))
        fused = covariance_intersection(one, other)
        off = PoseChart(fused.pose, CENTER_MM).coordinates(toy_pose())
        claims.append(off @ np.linalg.solve(fused.covariance_mm2, off))
    assert np.mean(claims) == pytest.approx(6.0, abs=1.2)
