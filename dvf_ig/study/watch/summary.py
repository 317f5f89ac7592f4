"""What the trials of a watch say together; the unit is the heart.

Rates of alarms have exact Poisson intervals, shares bootstrap intervals over hearts, both of 95 %.
Source: Garwood 1936 (Poisson); Efron and Tibshirani 1993, ch. 13.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from dvf_ig.study.hearts.summary import Estimate
from dvf_ig.study.trials import Line

from .trial import DRIFTS_MM_PER_MIN, SHIFTS_MM

WITHIN_BEATS = (1, 2, 3, 5, 10)
RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class ShiftSummary:
    """Shifts of one length.

    Attributes:
        mm: length; shifts: how many.
        within: number of beats to the share that is found within them.
        median_beats: until found.
    """

    mm: float
    shifts: int
    within: dict[str, Estimate]
    median_beats: float | None


@dataclass(frozen=True, slots=True)
class DriftSummary:
    """Drifts of one speed.

    Attributes:
        mm_per_min: speed; drifts: how many, one a heart.
        found: of them, by a suspension; the others were followed to the end.
        lag_median_mm, lag_max_mm: largest lag of the pose while it was in use, over hearts.
    """

    mm_per_min: float
    drifts: int
    found: int
    lag_median_mm: float | None
    lag_max_mm: float | None


@dataclass(frozen=True, slots=True)
class WatchSummary:
    """All hearts of one preset.

    Attributes:
        hearts: trials; failed: those that ended in an error.
        beats: compared with a pose in use; hours: with one.
        alarms: false ones, by what the user was told; alarms_per_hour.
        unconfirmed_s: time with a pose that no beat confirmed.
        statistic_p99, statistic_max: of the shift detector, quiet.
        tre_median_mm, bound_median_mm: of the pose in use, and of its stated 95 % bound.
        bound_covers: share of beats whose pose is within its bound.
    """

    hearts: int
    failed: int
    beats: int
    hours: float
    alarms: tuple[str, ...]
    alarms_per_hour: Estimate
    unconfirmed_s: float
    statistic_p99: float | None
    statistic_max: float | None
    tre_median_mm: float | None
    bound_median_mm: float | None
    bound_covers: Estimate
    shifts: tuple[ShiftSummary, ...]
    drifts: tuple[DriftSummary, ...]


def summarise_watch(lines: Sequence[Line]) -> WatchSummary:
    """Everything about one preset."""
    done = [line for line in lines if "refused" not in line]
    quiet = [x for line in done for x in line["statistic"]]
    alarms = tuple(alarm for line in done for alarm in line["alarms"])
    hours = sum(line["guided_s"] for line in done) / 3600.0
    return WatchSummary(
        hearts=len(lines),
        failed=len(lines) - len(done),
        beats=sum(line["beats"] for line in done),
        hours=hours,
        alarms=alarms,
        alarms_per_hour=poisson_rate(len(alarms), hours),
        unconfirmed_s=sum(line["unconfirmed_s"] for line in done),
        statistic_p99=float(np.percentile(quiet, 99)) if quiet else None,
        statistic_max=max(quiet, default=None),
        tre_median_mm=_median([x for line in done for x in line["tre_mm"]]),
        bound_median_mm=_median([x for line in done for x in line["tre_bound_mm"]]),
        bound_covers=share_over_hearts([_covered(line) for line in done]),
        shifts=tuple(_shifts(mm, done) for mm in SHIFTS_MM),
        drifts=tuple(_drifts(rate, done) for rate in DRIFTS_MM_PER_MIN),
    )


def poisson_rate(count: int, hours: float) -> Estimate:
    """Events an hour with the exact 95 % interval; None of no time."""
    if hours <= 0.0:
        return Estimate(None, None, None)
    low = float(chi2.ppf(0.025, 2 * count)) / 2.0 if count else 0.0
    high = float(chi2.ppf(0.975, 2 * count + 2)) / 2.0
    return Estimate(count / hours, low / hours, high / hours)


def share_over_hearts(of_hearts: Sequence[Sequence[bool]]) -> Estimate:
    """Share of all trials that are true, with its interval over resampled hearts."""
    hits = np.array([sum(trials) for trials in of_hearts], dtype=np.float64)
    sizes = np.array([len(trials) for trials in of_hearts], dtype=np.float64)
    if sizes.sum() == 0:
        return Estimate(None, None, None)
    drawn = np.random.default_rng(0).integers(0, len(sizes), size=(RESAMPLES, len(sizes)))
    shares = hits[drawn].sum(axis=1) / np.maximum(sizes[drawn].sum(axis=1), 1.0)
    low, high = np.percentile(shares, [2.5, 97.5])
    return Estimate(float(hits.sum() / sizes.sum()), float(low), float(high))


def _covered(line: Line) -> list[bool]:
    return [off <= bound for off, bound in zip(line["tre_mm"], line["tre_bound_mm"], strict=True)]


def _shifts(mm: float, done: Sequence[Line]) -> ShiftSummary:
    of_hearts = [line["shifts"][f"{mm:g}"] for line in done]
    every = [np.inf if k is None else float(k) for trials in of_hearts for k in trials]
    within = {
        str(n): share_over_hearts([[k is not None and k <= n for k in trials] for trials in of_hearts])
        for n in WITHIN_BEATS
    }
    return ShiftSummary(mm, len(every), within, _median(every))


def _drifts(rate: float, done: Sequence[Line]) -> DriftSummary:
    drifts = [line["drifts"][f"{rate:g}"] for line in done]
    drifts = [drift for drift in drifts if drift is not None]
    lags = [drift["lag_mm"] for drift in drifts]
    found = sum(drift["found_s"] is not None for drift in drifts)
    return DriftSummary(rate, len(drifts), found, _median(lags), max(lags, default=None))


def _median(values: Sequence[float]) -> float | None:
    middle = float(np.median(values)) if values else np.inf
    return middle if np.isfinite(middle) else None
