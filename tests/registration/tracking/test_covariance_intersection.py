"""Fusion of estimates with unknown correlation never claims more than is true."""

import numpy as np
import pytest

from dvf_ig.core import FloatArray
from dvf_ig.registration.tracking.pose_estimate import split_intersection


def halves(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    return 0.5 * covariance, 0.5 * covariance


def test_equal_estimates_meet_half_way_and_are_not_more_certain() -> None:
    offset, parts = split_intersection(halves(np.eye(6)), halves(np.eye(6)), np.full(6, 2.0))
    np.testing.assert_allclose(offset, np.full(6, 1.0), atol=1e-3)
    np.testing.assert_allclose(sum(parts), np.eye(6), atol=1e-9)


def test_each_direction_follows_the_estimate_that_knows_it() -> None:
    first, second = np.diag([0.01, 4.0]), np.diag([4.0, 0.01])
    offset, parts = split_intersection(halves(first), halves(second), np.array([1.0, 1.0]))
    np.testing.assert_allclose(np.diag(sum(parts)), 0.02, rtol=0.01)
    np.testing.assert_allclose(offset, [0.0, 1.0], atol=0.01)


def test_the_surer_of_two_estimates_is_taken_with_its_parts() -> None:
    first, second = (np.eye(3), np.eye(3)), (0.1 * np.eye(3), 0.15 * np.eye(3))
    offset, parts = split_intersection(first, second, np.ones(3))
    np.testing.assert_allclose(offset, np.ones(3))
    np.testing.assert_allclose(parts, second)


@pytest.mark.parametrize("correlation", [-0.9, 0.0, 0.5, 0.99])
def test_neither_part_is_smaller_than_the_true_one(correlation: float) -> None:
    rng = np.random.default_rng(3)
    first = np.diag([1.0, 0.3, 2.0]), np.diag([0.1, 0.2, 0.3])
    second = np.diag([0.4, 1.2, 0.9]), np.diag([0.5, 0.1, 0.2])
    unit = np.eye(3)
    gain = np.stack([split_intersection(first, second, axis)[0] for axis in unit], axis=1)
    offset, parts = split_intersection(first, second, np.zeros(3))
    np.testing.assert_array_equal(offset, 0.0)
    for one, other, fused in zip(first, second, parts, strict=True):
        cross = correlation * np.sqrt(one @ other)
        drawn = rng.multivariate_normal(np.zeros(6), np.block([[one, cross], [cross.T, other]]), 20_000)
        errors = drawn[:, :3] @ (unit - gain).T + drawn[:, 3:] @ gain.T
        assert np.linalg.eigvalsh(fused - np.cov(errors.T)).min() > -0.03
