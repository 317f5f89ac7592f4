"""Off, fixed and adaptive margins at equal free workspace; the unit is the heart.

A wall that is off by e where the tool is, and is widened by m, stands max(0, e − m) inside the true surface:
the violation depth of a tool that is stopped by it. An adaptive margin is a quantile of the stated σ there, a
fixed one the mean of all adaptive ones, every heart counting alike: so both take the same room from the
surgeon. A heart's figure is its 95th percentile over places and times; over hearts the 95th percentile is
given, and the mean, with bootstrap intervals of 95 % (Efron and Tibshirani 1993, ch. 13).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.guidance.margins.margin import LARGEST_MARGIN_MM
from dvf_ig.session.margins import SHAPE_SIGMA_MM, TIP_SIGMA_MM, TOOL_SIGMA_MM
from dvf_ig.study.hearts.summary import LEAST_HEARTS, RESAMPLES, Estimate, bootstrap
from dvf_ig.study.trials import Line

QUANTILES = (0.6, 0.7, 0.8, 0.9, 0.95, 0.975, 0.99)
STATED_QUANTILE = 0.95
"""The default of `MarginOptions`: the one that is reported."""
PERCENTILE = 95.0


@dataclass(frozen=True, slots=True)
class Violation:
    """Violation depth with one kind of margin.

    Attributes:
        mode: "off", "fixed" or "adaptive".
        p95_mm: 95th percentile over hearts of each heart's 95th percentile; mean_mm: its mean over hearts.
        pooled_p99_mm: 99th percentile over all places, times and hearts.
        share: of places and times at which the wall stands inside the surface.
    """

    mode: str
    p95_mm: Estimate
    mean_mm: Estimate
    pooled_p99_mm: float
    share: float


@dataclass(frozen=True, slots=True)
class AtWidth:
    """The two margins of one quantile.

    Attributes:
        quantile: of the adaptive margin.
        widening_mm: mean of either.
        fixed, adaptive: what they leave.
        reduction: share by which adaptive lowers `p95_mm` of fixed; None where that is zero.
        mean_reduction: the same of `mean_mm`.
    """

    quantile: float
    widening_mm: float
    fixed: Violation
    adaptive: Violation
    reduction: Estimate
    mean_reduction: Estimate


@dataclass(frozen=True, slots=True)
class MarginSummary:
    """All hearts.

    Attributes:
        hearts, recordings: that were compared; failed: recordings that ended in an error, or in which no pose
            was ever in use.
        bias_mm: mean error of the wall's distance over hearts; positive: the wall stands inside.
        error_mm: its root mean square.
        sigma_mm: median of the stated σ; sigma_spread: standard deviation of each heart's mean over the mean.
        z_rms: root mean square of error over σ: 1 where the session knows how far its wall may be off.
        correlation: rank correlation over recordings of RMS error and mean σ.
        off: without a margin; widths: with, by quantile.
    """

    hearts: int
    recordings: int
    failed: int
    bias_mm: float
    error_mm: float
    sigma_mm: float
    sigma_spread: float
    z_rms: float
    correlation: float | None
    off: Violation
    widths: tuple[AtWidth, ...]

    @property
    def stated(self) -> AtWidth:
        """At the default quantile."""
        return next(width for width in self.widths if width.quantile == STATED_QUANTILE)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Heart:
    error_mm: FloatArray
    sigma_mm: FloatArray


def total_sigma_mm(line: Line) -> FloatArray:
    """(n,) σ of the distance in a recording, as the session takes it for its margin, with |∇d| = 1."""
    parts = [np.array(line[f"{name}_mm"]) for name in ("registration", "phase", "ageing")]
    known = sum(np.square(part) for part in parts)
    return np.asarray(np.sqrt(known + SHAPE_SIGMA_MM**2 + TIP_SIGMA_MM**2 + TOOL_SIGMA_MM**2))


def summarise_margins(lines: Sequence[Line]) -> MarginSummary:
    """Everything about the margins.

    Raises:
        InvalidInputError: in none of the recordings a pose was ever in use.
    """
    done = [line for line in lines if line.get("times", 0) > 0]
    if not done:
        raise InvalidInputError("in none of the recordings a pose was in use; look at trials.jsonl")
    hearts = [_heart([line for line in done if line["heart"] == heart]) for heart in _hearts(done)]
    means = np.array([heart.sigma_mm.mean() for heart in hearts])
    error, sigma = (np.concatenate([getattr(h, f"{name}_mm") for h in hearts]) for name in ("error", "sigma"))
    return MarginSummary(
        hearts=len(hearts),
        recordings=len(done),
        failed=len(lines) - len(done),
        bias_mm=float(np.mean([heart.error_mm.mean() for heart in hearts])),
        error_mm=float(np.sqrt(np.mean(error**2))),
        sigma_mm=float(np.median(sigma)),
        sigma_spread=float(means.std() / means.mean()),
        z_rms=float(np.sqrt(np.mean((error / sigma) ** 2))),
        correlation=_rank_correlation(done),
        off=_violation("off", hearts, [np.zeros(1)] * len(hearts)),
        widths=tuple(_at_width(quantile, hearts) for quantile in QUANTILES),
    )


def _hearts(lines: Sequence[Line]) -> list[int]:
    return sorted({line["heart"] for line in lines})


def _heart(lines: Sequence[Line]) -> _Heart:
    """All recordings of one heart."""
    error = np.concatenate([line["error_mm"] for line in lines])
    return _Heart(error, np.concatenate([total_sigma_mm(line) for line in lines]))


def _at_width(quantile: float, hearts: Sequence[_Heart]) -> AtWidth:
    factor = NormalDist().inv_cdf(quantile)
    widths = [np.minimum(factor * heart.sigma_mm, LARGEST_MARGIN_MM) for heart in hearts]
    mean = float(np.mean([width.mean() for width in widths]))
    even = [np.full(1, mean)] * len(hearts)
    fixed, adaptive = _p95_of_hearts(hearts, even), _p95_of_hearts(hearts, widths)
    return AtWidth(
        quantile=quantile,
        widening_mm=mean,
        fixed=_violation("fixed", hearts, even),
        adaptive=_violation("adaptive", hearts, widths),
        reduction=_reduction(fixed, adaptive, _percentile),
        mean_reduction=_reduction(fixed, adaptive, np.mean),
    )


def _depths(hearts: Sequence[_Heart], widths: Sequence[FloatArray]) -> list[FloatArray]:
    return [np.maximum(heart.error_mm - width, 0.0) for heart, width in zip(hearts, widths, strict=True)]


def _p95_of_hearts(hearts: Sequence[_Heart], widths: Sequence[FloatArray]) -> FloatArray:
    return np.array([np.percentile(depth, PERCENTILE) for depth in _depths(hearts, widths)])


def _violation(mode: str, hearts: Sequence[_Heart], widths: Sequence[FloatArray]) -> Violation:
    depths, of_hearts = np.concatenate(_depths(hearts, widths)), _p95_of_hearts(hearts, widths).tolist()
    return Violation(
        mode=mode,
        p95_mm=bootstrap(of_hearts, _percentile),
        mean_mm=bootstrap(of_hearts, np.mean),
        pooled_p99_mm=float(np.percentile(depths, 99.0)),
        share=float((depths > 0.0).mean()),
    )


def _reduction(fixed: FloatArray, adaptive: FloatArray, statistic: Callable[..., Any]) -> Estimate:
    """1 − adaptive over fixed, with its interval over resampled hearts, the same for both; None over zero."""
    before, after = float(statistic(fixed, axis=0)), float(statistic(adaptive, axis=0))
    if before <= 0.0:
        return Estimate(None, None, None)
    value = 1.0 - after / before
    if len(fixed) < LEAST_HEARTS:
        return Estimate(value, None, None)
    drawn = np.random.default_rng(0).integers(0, len(fixed), size=(RESAMPLES, len(fixed)))
    below, above = statistic(fixed[drawn], axis=1), statistic(adaptive[drawn], axis=1)
    shares = 1.0 - above[below > 0.0] / below[below > 0.0]
    low, high = np.percentile(shares, [2.5, 97.5])
    return Estimate(value, float(low), float(high))


def _percentile(values: FloatArray, axis: int) -> Any:
    return np.percentile(values, PERCENTILE, axis=axis)


def _rank_correlation(lines: Sequence[Line]) -> float | None:
    errors = [float(np.sqrt(np.mean(np.square(line["error_mm"])))) for line in lines]
    stated = [float(total_sigma_mm(line).mean()) for line in lines]
    if len(lines) <= LEAST_HEARTS or np.ptp(stated) == 0.0:
        return None
    return float(spearmanr(errors, stated).statistic)
