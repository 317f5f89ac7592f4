"""Fit of what evidence says of a pose's error, on the lines of a study of hearts with their truth.

The unit is the heart: its trials share one weight, and whatever is judged by is predicted by fits on other
hearts (cross-fitting in FOLDS). Fitted are, for each kind of images, the tables of
`registration.evidence.assessment`:

Of a heart that its MR covers in part, errors are those over the surface of the covered part: elsewhere there
is no force. Its bound is that of the scaled covariance, and not fitted.

1. log(largest error) ≈ w₀ + Σ w_j x_j with w_j >= 0, Huber's weights for the residuals;
2. isotonic regression (pool adjacent violators) of success on the cross-fitted prediction;
3. the split-conformal 95 % quantile of its residuals, one trial a heart;
4. the prediction above which a pose is refused: 1 − GOOD_REFUSED of the good poses lie below;
5. the covariance's scale: gamma regression of the squared error, then scaled until the region
   of LEVEL holds as many cross-fitted trials;
6. ranges of the image statistics.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize, nnls
from scipy.stats import chi2

from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError
from dvf_ig.registration.evidence.assessment import FEATURES, SUCCESS_MM, logarithms
from dvf_ig.study.driver import Line

FOLDS = 5
LEAST_HEARTS = 20
"""Hearts of one kind below which nothing is fitted."""
CONFIDENCE = 0.95
LEVEL = 0.9
"""Level of the region that scales the covariance: of sixty trials only three lie beyond one of 95 %."""
DEGREES_OF_FREEDOM = 6
GOOD_REFUSED = 0.04
"""Share of poses below SUCCESS_MM that the prediction may refuse: with the checks' limits, at most 5 %."""
DISTURBED_WEIGHT = 0.2
"""Weight of a trial with drawn errors of calibration and clock, relative to one without: it is not known how
careless interventions are; such errors are taken to be the lesser part."""
HUBER = 1.345
"""Standard deviations beyond which residuals count linearly (Huber 1981)."""
RIDGE = 0.02
"""Ridge of the weights, in squared standard deviations of a feature: like checks share their weight."""
SCALE_RIDGE = 1.0
"""Ridge of the weights of the covariance's scale, in trials, for features of standard deviation 1. On 65
threshold hearts 0.3 and 3 have the same coverage and a mean χ² of 5.7 and 5.4 calm, 6.0 and 6.3 with poor
images."""
RANGE_MARGIN = 0.25
"""Share of the range of an image statistic over the hearts that is added at either end."""
JUDGED_LATER = ("DOUBTFUL", "UNBOUNDED", "CONVERGED")
"""Stops of poses that no check refused by its own limit: the others come before the tables."""


def fit_tables(lines: Sequence[Line]) -> dict[str, Any]:
    """The content of `calibrated.json`: a table for each kind of images with LEAST_HEARTS hearts or more.

    Args:
        lines: each with `heart`, `world`, `images`, `quality`, `disturbed`, `stop`, `tre_mm`, `tre_max_mm`,
            (`covered_mm`, `covered_max_mm`,) `features` and `statistics` (by name); lines of
            trials that ended in an error, and of hearts changed on purpose, are left out.
    Raises:
        InvalidInputError: no kind has enough hearts, or a line lacks a field.
    """
    completed = [line for line in lines if "refused" not in line and line.get("change") is None]
    kinds = sorted({str(line["images"]) for line in completed})
    tables = {}
    for kind in kinds:
        of_kind = [line for line in completed if line["images"] == kind]
        if len({_heart(line) for line in of_kind}) >= LEAST_HEARTS:
            tables[kind] = fit_table(of_kind)
    if not tables:
        raise InvalidInputError(
            f"no kind of images has {LEAST_HEARTS} hearts; run the study on more of a list"
        )
    return {"schema": "dvf_ig.calibrated_evidence/1", "kinds": tables}


def fit_table(lines: Sequence[Line]) -> dict[str, Any]:
    """The table of one kind of images, as JSON holds it."""
    try:
        x = np.stack([logarithms(line["features"]) for line in lines])
        mean, error = np.array([assessed_errors_mm(line) for line in lines], dtype=np.float64).T
        success = mean < SUCCESS_MM
        passed = np.array([line["stop"] in JUDGED_LATER for line in lines])
        statistics = [line["statistics"] for line in lines]
    except KeyError as exc:
        raise InvalidInputError(f"a line of the study has no '{exc.args[0]}'; run the study again") from exc
    hearts = np.unique([_heart(line) for line in lines], return_inverse=True)[1].ravel()
    disturbed = np.array([line["disturbed"] for line in lines], dtype=np.bool_)
    weight = np.where(disturbed, DISTURBED_WEIGHT, 1.0)
    weight = weight / np.bincount(hearts, weight)[hearts]
    low, high, missing = feature_limits(x, success)
    features = np.clip(np.where(np.isnan(x), missing, x), low, high)
    target = np.log(np.clip(error, 0.1, 100.0))
    predicted = cross_fitted(features, target, weight, hearts)
    intercept, weights = fit_error(features, target, weight)
    at, chance = isotonic(predicted[passed], success[passed], weight[passed])
    good = passed & success
    refused = ~passed
    squared = _squared_errors(lines, passed & ~disturbed)
    scale_intercept, scale_weights = fit_scale(features, squared, weight, hearts)
    return {
        "hearts": int(hearts.max()) + 1,
        "trials": len(lines),
        "features": list(FEATURES),
        "intercept": intercept,
        "weights": weights.tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "missing": missing.tolist(),
        "predicted": at.tolist(),
        "probability": chance.tolist(),
        "refused_probability": float((weight[refused & success].sum() + 1.0) / (weight[refused].sum() + 2.0)),
        "bound_quantile": None
        if _partly(lines)
        else conformal_quantile((target - predicted)[passed], hearts[passed], weight[passed]),
        "largest": _quantile(predicted[good], weight[good], 1.0 - GOOD_REFUSED),
        "scale_intercept": scale_intercept,
        "scale_weights": scale_weights.tolist(),
        **_ranges(statistics, int(hearts.max()) + 1),
    }


def assessed_errors_mm(line: Line) -> tuple[float, float]:
    """Mean and largest error of a trial that probability and bound refer to."""
    if line.get("covered_mm") is not None:
        return line["covered_mm"], line["covered_max_mm"]
    return line["tre_mm"], line["tre_max_mm"]


def _partly(lines: Sequence[Line]) -> bool:
    """Whether the hearts' MR covers them in part."""
    return any(line.get("covered_mm") is not None for line in lines)


def _heart(line: Line) -> str:
    return f"{line['world']} {line['heart']}"


def feature_limits(x: FloatArray, success: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(f,) lowest and highest logarithm that counts, and what a check counts as that could not be made.

    Below the tenth percentile of all better is not better; a check that was not made counts as a value that
    nine in ten good poses stay below.
    """
    empty = np.isnan(x).all(axis=0)
    safe = np.where(empty, 0.0, x)
    low, high = np.nanpercentile(safe, [10.0, 99.5], axis=0)
    missing = np.nanpercentile(np.where(success[:, None], safe, np.nan), 90.0, axis=0)
    return low, high, np.clip(np.where(np.isnan(missing), high, missing), low, high)


def fit_error(x: FloatArray, target: FloatArray, weight: FloatArray) -> tuple[float, FloatArray]:
    """Intercept and non-negative weights of a robust regression.

    Args:
        x: (n, f); target: (n,); weight: (n,) of each trial.
    """
    scale = np.maximum(x.std(axis=0), 1e-6)
    own, solved, offset = weight.copy(), np.zeros(x.shape[1]), 0.0
    for _ in range(10):
        mean_x, mean_y = np.average(x, axis=0, weights=own), float(np.average(target, weights=own))
        root = np.sqrt(own / own.sum())
        rows = np.vstack([root[:, None] * (x - mean_x) / scale, math.sqrt(RIDGE) * np.eye(x.shape[1])])
        values = np.concatenate([root * (target - mean_y), np.zeros(x.shape[1])])
        solved = nnls(rows, values)[0] / scale
        offset = mean_y - float(mean_x @ solved)
        apart = np.abs(target - offset - x @ solved)
        spread = max(1.4826 * float(np.median(apart)), 1e-6)
        own = weight * np.minimum(1.0, HUBER * spread / np.maximum(apart, 1e-12))
    return offset, solved


def cross_fitted(x: FloatArray, target: FloatArray, weight: FloatArray, hearts: IntArray) -> FloatArray:
    """(n,) prediction for each trial from a fit on other hearts."""
    fold, out = _fold_of(hearts), np.empty(len(target))
    for k in range(FOLDS):
        held_out = fold == k
        offset, weights = fit_error(x[~held_out], target[~held_out], weight[~held_out])
        out[held_out] = offset + x[held_out] @ weights
    return out


def _fold_of(hearts: IntArray) -> IntArray:
    """(n,) which of FOLDS each trial is held out with: all of a heart with the same."""
    return np.asarray(np.random.default_rng(0).permutation(int(hearts.max()) + 1)[hearts] % FOLDS)


def isotonic(predicted: FloatArray, success: BoolArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k,) increasing predictions and (k,) decreasing shares of success: pool adjacent violators.

    One success at the worst and one failure at the best prediction are added: no share is 0 or 1.
    """
    order = np.argsort(predicted, kind="stable")
    at = np.concatenate([[predicted.min()], predicted[order], [predicted.max()]])
    value = np.concatenate([[0.0], success[order].astype(np.float64), [1.0]])
    mass = np.concatenate([[1.0], weight[order], [1.0]])
    blocks: list[list[float]] = []
    for place, share, own in zip(at, value, mass, strict=True):
        blocks.append([share * own, own, place * own])
        while len(blocks) > 1 and blocks[-2][0] * blocks[-1][1] <= blocks[-1][0] * blocks[-2][1]:
            last = blocks.pop()
            blocks[-1] = [a + b for a, b in zip(blocks[-1], last, strict=True)]
    sums = np.array(blocks)
    return sums[:, 2] / sums[:, 1], sums[:, 0] / sums[:, 1]


def _quantile(values: FloatArray, weight: FloatArray, share: float) -> float:
    """Weighted quantile."""
    order = np.argsort(values)
    reached = np.cumsum(weight[order]) / weight.sum()
    return float(values[order][int(np.searchsorted(reached, share))])


def conformal_quantile(residual: FloatArray, hearts: IntArray, weight: FloatArray) -> float | None:
    """The ⌈(n + 1)·0.95⌉-th smallest of n residuals, one trial a heart; None if n is too small.

    Each heart's trials share one mass: a weighted quantile with the mass of one new heart at infinity.
    """
    share = weight / np.bincount(hearts, weight)[hearts]
    order = np.argsort(residual)
    reached = np.cumsum(share[order]) / (share.sum() + 1.0)
    enough = np.flatnonzero(reached >= CONFIDENCE - 1e-12)
    return float(residual[order][enough[0]]) if len(enough) else None


def _squared_errors(lines: Sequence[Line], counts: BoolArray) -> FloatArray:
    """(n,) χ² by the covariance before it was scaled, NaN where it does not count.

    Trials with drawn errors do not count: a covariance speaks of what it knows.
    """
    squared = np.full(len(lines), np.nan)
    for k in np.flatnonzero(counts).tolist():
        if lines[k]["chi2"] is not None:
            squared[k] = lines[k]["chi2"] * lines[k]["covariance_scale"]
    return squared


def fit_scale(
    x: FloatArray, squared: FloatArray, weight: FloatArray, hearts: IntArray
) -> tuple[float, FloatArray]:
    """v₀ and (f,) v of the covariance's scale exp(v₀ + v·x).

    Args:
        x: (n, f); squared: (n,) χ² before scaling, NaN where it does not count; weight, hearts: (n,).
    Raises:
        InvalidInputError: no trial counts.
    """
    counts = np.isfinite(squared)
    if not counts.any():
        raise InvalidInputError("no trial of the study has a covariance and an error to hold against it")
    x, ratio, own, fold = (
        x[counts],
        squared[counts] / DEGREES_OF_FREEDOM,
        weight[counts],
        _fold_of(hearts)[counts],
    )
    left = np.empty(len(ratio))
    for k in range(FOLDS):
        held_out = fold == k
        intercept, weights = gamma_regression(x[~held_out], ratio[~held_out], own[~held_out])
        left[held_out] = ratio[held_out] * np.exp(-intercept - x[held_out] @ weights)
    intercept, weights = gamma_regression(x, ratio, own)
    region = float(chi2.ppf(LEVEL, DEGREES_OF_FREEDOM)) / DEGREES_OF_FREEDOM
    return intercept + math.log(_quantile(left, own, LEVEL) / region), weights


def gamma_regression(x: FloatArray, ratio: FloatArray, weight: FloatArray) -> tuple[float, FloatArray]:
    """Intercept and weights of the logarithm of the mean of (n,) ratios >= 0, linear in (n, f) features.

    A worse check never narrows the covariance, nor does an error that it predicts itself: the weights are not
    negative, that of the predicted error, whose square is already in the covariance, not below -2.
    Source: the quasi-likelihood of gamma regression (McCullagh and Nelder 1989, ch. 8).
    """
    size = np.maximum(x.std(axis=0), 1e-6)
    mean = np.average(x, axis=0, weights=weight)
    features = (x - mean) / size

    def loss(values: FloatArray) -> float:
        logarithm = values[0] + features @ values[1:]
        fit = float(weight @ (logarithm + ratio * np.exp(-logarithm)))
        return fit + SCALE_RIDGE * float(values[1:] @ values[1:])

    least = np.where(np.array(FEATURES) == "predicted_mm", -2.0, 0.0) * size
    bounds = [(None, None), *((low, None) for low in least.tolist())]
    solution = minimize(loss, np.zeros(x.shape[1] + 1), method="L-BFGS-B", bounds=bounds).x
    weights = solution[1:] / size
    return float(solution[0] - mean @ weights), weights


def _ranges(statistics: Sequence[dict[str, float]], hearts: int) -> dict[str, Any]:
    """Ranges with their margin, and the largest share of like hearts outside of any (by exchangeability)."""
    names = list(statistics[0])
    values = np.array([[row[name] for name in names] for row in statistics])
    low, high = values.min(axis=0), values.max(axis=0)
    margin = RANGE_MARGIN * np.maximum(high - low, 1e-9)
    return {
        "ranges": {
            name: [float(a), float(b)] for name, a, b in zip(names, low - margin, high + margin, strict=True)
        },
        "outside_p": min(1.0, 2.0 * len(names) / (hearts + 1)),
    }
