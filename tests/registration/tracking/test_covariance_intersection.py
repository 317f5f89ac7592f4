"""Fusion of estimates with unknown correlation never claims more than is true."""

import numpy as np
import pytest

from dvf_ig.registration.tracking.pose_estimate import covariance_intersection


def test_equal_estimates_meet_half_way_and_are_not_more_certain() -> None:
    offset, covariance = covariance_intersection(np.eye(6), np.eye(6), np.full(6, 2.0))
    np.testing.assert_allclose(offset, np.full(6, 1.0), atol=1e-3)
    np.testing.assert_allclose(covariance, np.eye(6), atol=1e-9)


def test_each_direction_follows_the_estimate_that_knows_it() -> None:
    first, second = np.diag([0.01, 4.0]), np.diag([4.0, 0.01])
    offset, covariance = covariance_intersection(first, second, np.array([1.0, 1.0]))
    np.testing.assert_allclose(np.diag(covariance), 0.02, rtol=0.01)
    np.testing.assert_allclose(offset, [0.0, 1.0], atol=0.01)


def test_the_surer_of_two_estimates_is_taken_where_the_other_adds_nothing() -> None:
    offset, covariance = covariance_intersection(np.eye(3), 0.25 * np.eye(3), np.ones(3))
    np.testing.assert_allclose(offset, np.ones(3))
    np.testing.assert_allclose(covariance, 0.25 * np.eye(3))


@pytest.mark.parametrize("correlation", [-0.9, 0.0, 0.5, 0.99])
def test_the_covariance_is_no_smaller_than_the_true_one(correlation: float) -> None:
    rng = np.random.default_rng(3)
    first, second = np.diag([1.0, 0.3, 2.0]), np.diag([0.4, 1.2, 0.9])
    cross = correlation * np.sqrt(first @ second)
    joint = np.block([[first, cross], [cross.T, second]])
    drawn = rng.multivariate_normal(np.zeros(6), joint, 20_000)
    offset, covariance = covariance_intersection(first, second, np.zeros(3))
    np.testing.assert_array_equal(offset, 0.0)
    gain = np.stack([covariance_intersection(first, second, unit)[0] for unit in np.eye(3)], axis=1)
    errors = drawn[:, :3] + (drawn[:, 3:] - drawn[:, :3]) @ gain.T
    assert np.linalg.eigvalsh(covariance - np.cov(errors.T)).min() > -0.03
