"""Fitted tables on drawn trials whose errors follow the evidence in a known way."""

import json
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from dvf_ig.core import InvalidInputError
from dvf_ig.registration.evidence.assessment import (
    SUCCESS_MM,
    ImageStatistics,
    Table,
    assess,
    table_from_json,
)
from dvf_ig.study.hearts.fit import conformal_quantile, cross_fitted, fit_tables, isotonic

Line = dict[str, Any]
INSIDE = ImageStatistics(*[1.0] * 10)


def drawn(seed: int, hearts: int, trials: int = 3) -> list[Line]:
    """Half-volumes and the covariance tell the error but for a factor of 1.25; other checks are noise."""
    rng = np.random.default_rng(seed)
    lines = []
    for heart in range(hearts):
        of_heart = rng.normal(0.0, 0.12)
        for _ in range(trials):
            halves, predicted = np.exp(rng.normal(0.0, 0.5, 2))
            error = 1.4 * halves**0.5 * predicted**0.5 * np.exp(of_heart + rng.normal(0.0, 0.18))
            features = {
                "z_score": 0.1 * float(np.exp(rng.normal(0, 0.2))),
                "split_half_mm": float(np.exp(rng.normal(0, 0.5))),
                "phase_mm": None if rng.random() < 0.1 else 1.0,
                "half_volume_mm": float(halves),
                "boundary_mm": 1.0,
                "phase_offset_ratio": 1.0,
                "unexplained": 0.5,
                "predicted_mm": float(predicted),
                "not_imaged": None,
            }
            statistics = ImageStatistics(*rng.uniform(0.9, 1.1, 10)).values()
            lines.append(
                {
                    "heart": heart,
                    "world": "first",
                    "images": "sweep",
                    "disturbed": False,
                    "stop": "CONVERGED",
                    "tre_mm": float(error),
                    "chi2": 6.0 * (error / predicted) ** 2 * rng.chisquare(6) / 6.0,
                    "covariance_scale": 1.0,
                    "tre_max_mm": float(1.8 * error),
                    "features": features,
                    "statistics": statistics,
                }
            )
    return lines


@pytest.fixture(scope="module")
def fitted() -> Table:
    held = json.loads(json.dumps(fit_tables(drawn(1, 150))))
    return table_from_json(held["kinds"]["sweep"])


def test_the_scaled_covariance_s_region_holds_95_percent_whatever_was_predicted(fitted: Table) -> None:
    lines = drawn(3, 400, trials=1)
    logs = np.array([np.log(line["features"]["predicted_mm"]) for line in lines])
    scales = np.array([assess(fitted, line["features"], INSIDE).covariance_scale for line in lines])
    squared = np.array([line["chi2"] for line in lines])
    region = chi2.ppf(0.95, 6)
    for half in (logs < 0, logs >= 0):
        before, after = (np.mean(by[half] <= region) for by in (squared, squared / scales))
        assert 0.92 <= after <= 0.98
        assert abs(after - 0.95) < abs(before - 0.95)
        assert 4.2 < np.mean(squared[half] / scales[half]) < 6.6  # heavier tails than χ²: a smaller mean


def test_a_study_without_covariances_is_told() -> None:
    lines = drawn(1, 30, trials=1)
    for line in lines:
        line["chi2"] = None
    with pytest.raises(InvalidInputError, match="no trial of the study has a covariance"):
        fit_tables(lines)


def test_the_bound_covers_and_the_probability_is_a_frequency_on_other_hearts(fitted: Table) -> None:
    lines = drawn(2, 400, trials=1)
    stated = [assess(fitted, line["features"], ImageStatistics(*[1.0] * 10)) for line in lines]
    covered = [line["tre_max_mm"] <= (s.tre_bound_mm or 0.0) for line, s in zip(lines, stated, strict=True)]
    assert 0.91 <= np.mean(covered) <= 0.99  # 0.95 and 1.1 % of 400 hearts, and of 150 fitted
    chance = np.array([s.success_probability for s in stated], dtype=np.float64)
    success = np.array([line["tre_mm"] < SUCCESS_MM for line in lines])
    for low, high in ((0.0, 0.4), (0.4, 0.8), (0.8, 1.0)):
        here = (chance >= low) & (chance <= high)
        assert abs(chance[here].mean() - success[here].mean()) < 0.12


def test_of_a_heart_that_is_covered_in_part_the_errors_are_those_of_the_covered_part() -> None:
    whole = drawn(1, 30, trials=1)
    part = [
        {**line, "covered_mm": 0.5 * line["tre_mm"], "covered_max_mm": 0.5 * line["tre_max_mm"]}
        for line in whole
    ]
    of_whole, of_part = (table_from_json(fit_tables(lines)["kinds"]["sweep"]) for lines in (whole, part))
    assert of_part.intercept == pytest.approx(of_whole.intercept - np.log(2.0))
    assert (of_part.bound_quantile, of_whole.bound_quantile < 1.0) == (np.inf, True)


def test_checks_that_tell_nothing_weigh_little_and_none_is_negative(fitted: Table) -> None:
    assert (fitted.weights >= 0.0).all()
    named = dict(
        zip(
            ["z", "half", "phase", "volume", "boundary", "offset", "lc2", "sigma", "imaged"],
            fitted.weights,
            strict=True,
        )
    )
    assert named["volume"] == pytest.approx(0.5, abs=0.12)
    assert named["sigma"] == pytest.approx(0.5, abs=0.12)
    assert named["half"] < 0.08
    assert named["imaged"] == 0.0  # never measured of a heart that is covered


def test_few_good_poses_are_refused(fitted: Table) -> None:
    lines = [line for line in drawn(3, 400, trials=1) if line["tre_mm"] < SUCCESS_MM]
    doubtful = [assess(fitted, line["features"], ImageStatistics(*[1.0] * 10)).doubtful for line in lines]
    assert np.mean(doubtful) < 0.08


def test_isotonic_regression_pools_what_is_out_of_order() -> None:
    at, chance = isotonic(np.array([1.0, 2.0, 3.0, 4.0]), np.array([True, False, True, False]), np.ones(4))
    # a failure is added at 1 and a success at 4: (0,1 | 0,1 | 0,1) pool into one half
    np.testing.assert_allclose(chance, [0.5])
    assert at == pytest.approx([2.5])


def test_a_conformal_quantile_needs_nineteen_hearts() -> None:
    values = np.arange(19.0)
    assert conformal_quantile(values, np.arange(19), np.ones(19)) == 18.0
    assert conformal_quantile(values[:18], np.arange(18), np.ones(18)) is None
    # trials of one heart share its mass
    repeated = np.concatenate([values, np.full(50, 100.0)])
    hearts = np.concatenate([np.arange(19), np.full(50, 19)])
    assert conformal_quantile(repeated, hearts, np.ones(69)) == 100.0
    assert conformal_quantile(repeated, np.arange(69), np.ones(69)) == 100.0


def test_a_heart_is_predicted_by_others() -> None:
    """A feature that names the heart explains nothing of a heart that was left out."""
    hearts = np.repeat(np.arange(40), 3)
    target = np.random.default_rng(0).normal(size=40)[hearts]
    found = cross_fitted(np.eye(40)[hearts], target, np.ones(120), hearts)
    assert np.corrcoef(found, target)[0, 1] < 0.2


def test_too_few_hearts_and_missing_fields_are_told() -> None:
    with pytest.raises(InvalidInputError, match="no kind of images has 20 hearts"):
        fit_tables(drawn(1, 5))
    lines = drawn(1, 30, trials=1)
    del lines[3]["statistics"]
    with pytest.raises(InvalidInputError, match="no 'statistics'"):
        fit_tables(lines)
