"""The one inlier rule: robust standard deviations, and the alternation of fit and selection on a mean."""

import numpy as np
import pytest

from dvf_ig.calibration.inliers import MEDIAN_LENGTH, InlierRule, fit_inliers, robust_sd
from dvf_ig.core import BoolArray, FloatArray


@pytest.mark.parametrize("dimensions", [1, 2, 3, 6])
def test_the_median_length_gives_the_standard_deviation(dimensions: int) -> None:
    vectors = 0.7 * np.random.default_rng(0).standard_normal((40_000, dimensions))
    assert robust_sd(np.linalg.norm(vectors, axis=1), dimensions) == pytest.approx(0.7, rel=0.02)


def test_the_median_of_a_maxwell_distribution() -> None:
    # tabulated median of the Maxwell distribution, in units of its scale
    assert pytest.approx(1.53817, abs=1e-5) == MEDIAN_LENGTH


def test_limits_come_from_all_samples_from_inliers_or_from_the_near_ones() -> None:
    lengths, inliers = np.array([1.0, 1.0, 1.0, 9.0, 9.0, 9.0, 9.0]), np.arange(7) < 3
    unit = 2.0 / MEDIAN_LENGTH
    assert InlierRule(2.0).limit(lengths, inliers) == pytest.approx(9.0 * unit)
    assert InlierRule(2.0, scale_from_inliers=True).limit(lengths, inliers) == pytest.approx(unit)
    assert InlierRule(2.0, scale_below=5.0).limit(lengths, inliers) == pytest.approx(unit)


def test_a_sample_is_within_the_limit_of_every_measure() -> None:
    millimetres = np.array([[1.0, 1.0], [1.0, 50.0], [1.0, 1.0], [1.0, 1.0]])
    degrees = np.array([0.1, 0.1, 8.0, 0.1])
    kept, limits = InlierRule().select([millimetres, degrees], np.ones(4, dtype=np.bool_))
    assert kept.tolist() == [True, False, False, True]
    assert limits == pytest.approx((5.0 / MEDIAN_LENGTH, 0.5 / MEDIAN_LENGTH))


def centers(points: FloatArray, start: BoolArray) -> tuple[FloatArray | None, BoolArray]:
    found = fit_inliers(
        lambda inliers, _: points[inliers].mean(axis=0),
        lambda center: [np.linalg.norm(points - center, axis=1)],
        start,
        InlierRule(),
    )
    return found.model, found.inliers


def test_outliers_leave_no_trace_in_the_fit() -> None:
    points = np.random.default_rng(1).standard_normal((60, 3))
    points[:20] += 40.0
    center, inliers = centers(points, np.arange(60) >= 15)
    assert not inliers[:20].any()
    assert inliers[20:].all()
    np.testing.assert_array_equal(center, points[20:].mean(axis=0))


def test_too_few_samples_give_no_model() -> None:
    center, inliers = centers(np.zeros((5, 3)), np.arange(5) < 2)
    assert center is None
    assert inliers.sum() == 2
