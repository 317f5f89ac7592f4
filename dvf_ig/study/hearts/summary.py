"""Summary and table of the trials on hearts; the unit is the heart.

Shares have Wilson intervals, percentiles bootstrap intervals over hearts (Efron and Tibshirani 1993, ch. 13),
both of 95 %. Where a heart has several trials, hearts are resampled with all of theirs, and a share's
interval is that of as many trials as there are hearts. A trial whose registration ended in an error is no
success, and has no other figure.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import chi2

from dvf_ig.core import FloatArray
from dvf_ig.study.driver import Line, Rows
from dvf_ig.study.hearts.fit import assessed_errors_mm
from dvf_ig.study.statistics import (
    FAILURE_MM,
    SUCCESS_MM,
    Estimate,
    Share,
    auc_of,
    bootstrap,
    calibration_error,
    calibration_error_by_chance,
    estimate_text,
    median_of,
    number_text,
    share_of,
    share_text,
)

COVERAGE = 0.95
MARGIN_SIGMAS = 1.0
"""Adaptive margins of this many standard deviations are compared with a fixed one: a wall truly lies further
out by more at one of six places, so that either leaves something to compare."""
WALLS = {
    "seen_rigid_mm": "seen wall, rigid, mm",
    "seen_mm": "seen wall, as guided, mm",
    "seen_systole_mm": "at end-systole, mm",
    "oracle_rigid_mm": "seen wall, true matches, rigid, mm",
    "oracle_mm": "seen wall, true matches, modes, mm",
    "unseen_rigid_mm": "unseen wall, rigid, mm",
    "unseen_mm": "unseen wall, as guided, mm",
    "known_mm": "where a force may be given, mm",
    "seen_known_share": "its share of the seen wall",
    "seen_per_sigma": "error over σ, seen",
    "unseen_per_sigma": "error over σ, unseen",
}
"""Fields of `WallErrors` with their rows in the table."""


@dataclass(frozen=True, slots=True)
class HeartGroup:
    """The hearts of one kind of images and one quality.

    Attributes:
        world, images, quality, disturbed: what was registered (see `trial`).
        hearts, trials: how many; failed: trials that ended in an error.
        success: mean error over the targets below SUCCESS_MM.
        tre_median_mm, tre_p95_mm: over hearts, of each heart's mean error over its targets.
        target_p95_mm, target_max_mm: 95th percentile over hearts of each heart's 95th percentile over its
            targets, and of its largest.
        covered_success, covered_median_mm: likewise of the mean error over the covered part of hearts that
            their MR covers in part, the only part with a force; without a value for whole hearts.
        floor_median_mm, floor_p95_mm: over hearts, of the error that no rigid registration removes; without a
            value in the first world, which does not state it.
        bad_refused: of hearts with an error above FAILURE_MM; good_refused: of those below SUCCESS_MM.
        chi2_mean: of the squared error by the stated covariance, 6 if that is right.
        region_covers: of hearts whose true pose lies in the stated 95 % region.
        bound_covers: of hearts whose largest error over the targets, or over the covered part, stays below
            `tre_bound_mm`.
        bound_median_mm: of the bounds.
        calibration_error: mean difference between stated probability and success over tenths of it.
        calibration_error_by_chance: its mean if the probabilities are right.
        auc: chance that a success has a higher stated probability than a failure.
        outside: hearts for which no probability was stated.
        seconds_median: of one registration.
        change: key of `recordings.CHANGES`, or None; used: of all trials.
        walls: fields of `WallErrors`, each with its median over hearts; those of σ over followed ones.
        margins: what margins leave of violations; None without walls.
        followed: of all trials.
    """

    world: str
    images: str
    quality: str
    disturbed: bool
    hearts: int
    trials: int
    failed: int
    success: Share
    tre_median_mm: Estimate
    tre_p95_mm: Estimate
    target_p95_mm: Estimate
    target_max_mm: Estimate
    covered_success: Share
    covered_median_mm: Estimate
    floor_median_mm: Estimate
    floor_p95_mm: Estimate
    bad_refused: Share
    good_refused: Share
    chi2_mean: Estimate
    region_covers: Share
    bound_covers: Share
    bound_median_mm: float | None
    calibration_error: float | None
    calibration_error_by_chance: float | None
    auc: float | None
    outside: int
    seconds_median: float | None
    change: str | None
    used: Share
    followed: Share
    walls: dict[str, Estimate]
    margins: "Margins | None"


@dataclass(frozen=True, slots=True)
class Margins:
    """How deep a tool gets into the true wall that stops where a margin ends, at places with a force.

    Attributes:
        mean_mm: of the margins, which take the same room on average.
        without_mm, fixed_mm, adaptive_mm: 95th percentile over the places of all hearts of the depth, without
            a margin, with one for all, and with one of MARGIN_SIGMAS standard deviations of each place.
    """

    mean_mm: float
    without_mm: float
    fixed_mm: float
    adaptive_mm: float


def summarise_hearts(lines: Sequence[Line]) -> list[HeartGroup]:
    """A group for every world, kind of images, quality, whether disturbed, and change, as they appear."""
    groups: dict[tuple[Any, ...], list[Line]] = {}
    for line in lines:
        key = tuple(line.get(name) for name in ("world", "images", "quality", "disturbed", "change"))
        groups.setdefault(key, []).append(line)
    return [_group(key, of) for key, of in groups.items()]


def _group(key: tuple[Any, ...], lines: Sequence[Line]) -> HeartGroup:
    world, images, quality, disturbed, change = key
    completed = [line for line in lines if "refused" not in line]
    stated = [line for line in completed if line["success_probability"] is not None]
    bounded = [line for line in completed if line.get("tre_bound_mm") is not None]
    placed = [line for line in completed if line["chi2"] is not None]
    parts = [line for line in completed if line.get("covered_mm") is not None]
    floored = [line for line in completed if line.get("floor_mm") is not None]
    bad = [line for line in completed if assessed_errors_mm(line)[0] > FAILURE_MM]
    good = [line for line in completed if assessed_errors_mm(line)[0] < SUCCESS_MM]
    measured = [line for line in completed if line.get("walls") is not None]
    region = float(chi2.ppf(COVERAGE, 6))
    return HeartGroup(
        world=str(world),
        images=str(images),
        quality=str(quality),
        disturbed=bool(disturbed),
        hearts=len({line["heart"] for line in lines}),
        trials=len(lines),
        failed=len(lines) - len(completed),
        success=_share(lines, lambda line: "refused" not in line and line["tre_mm"] < SUCCESS_MM),
        tre_median_mm=_over_hearts(completed, "tre_mm", np.median),
        tre_p95_mm=_over_hearts(completed, "tre_mm", _p95),
        target_p95_mm=_over_hearts(completed, "tre_p95_mm", _p95),
        target_max_mm=_over_hearts(completed, "tre_max_mm", _p95),
        covered_success=_share(parts, lambda line: line["covered_mm"] < SUCCESS_MM),
        covered_median_mm=_over_hearts(parts, "covered_mm", np.median),
        floor_median_mm=_over_hearts(floored, "floor_mm", np.median),
        floor_p95_mm=_over_hearts(floored, "floor_mm", _p95),
        bad_refused=_share(bad, _is_refused),
        good_refused=_share(good, _is_refused),
        chi2_mean=_over_hearts(placed, "chi2", np.mean),
        region_covers=_share(placed, lambda line: line["chi2"] <= region),
        bound_covers=_share(bounded, lambda line: assessed_errors_mm(line)[1] <= line["tre_bound_mm"]),
        bound_median_mm=median_of([line["tre_bound_mm"] for line in bounded]),
        calibration_error=calibration_error(
            [line["success_probability"] for line in stated],
            [assessed_errors_mm(line)[0] < SUCCESS_MM for line in stated],
        ),
        calibration_error_by_chance=calibration_error_by_chance(_probabilities(stated)),
        auc=auc_of(_probabilities(bad), _probabilities(good)),
        outside=len(completed) - len(stated),
        seconds_median=median_of([line["seconds"] for line in completed]),
        change=change,
        used=_share(lines, lambda line: "refused" not in line and line["usable"]),
        followed=_share(measured, lambda line: line["walls"]["followed"]),
        walls={name: _wall_median(measured, name) for name in WALLS},
        margins=_margins(measured),
    )


def _margins(lines: Sequence[Line]) -> Margins | None:
    outward = np.array([mm for line in lines for mm in line["walls"]["outward_mm"]])
    sigma = np.array([mm for line in lines for mm in line["walls"]["sigma_mm"]])
    if not len(outward):
        return None
    margins = MARGIN_SIGMAS * sigma
    mean = float(margins.mean())
    without, fixed, adaptive = (
        float(np.percentile(np.maximum(outward - margin, 0.0), 95)) for margin in (0.0, mean, margins)
    )
    return Margins(mean, without, fixed, adaptive)


def _wall_median(lines: Sequence[Line], name: str) -> Estimate:
    stated = [line for line in lines if line["walls"][name] is not None]
    return bootstrap([line["walls"][name] for line in stated], np.median, [line["heart"] for line in stated])


def _over_hearts(lines: Sequence[Line], name: str, statistic: Callable[..., Any]) -> Estimate:
    return bootstrap([line[name] for line in lines], statistic, [line["heart"] for line in lines])


def _p95(values: FloatArray, axis: int) -> FloatArray:
    return np.asarray(np.percentile(values, 95, axis=axis))


def _share(lines: Sequence[Line], true: Callable[[Line], bool]) -> Share:
    """Share of trials, with the interval of as many trials as there are hearts."""
    return share_of(sum(map(true, lines)), len(lines), len({line["heart"] for line in lines}))


def _is_refused(line: Line) -> bool:
    return not line["usable"]


def _probabilities(lines: Sequence[Line]) -> list[float]:
    stated = [line["success_probability"] for line in lines]
    return [math.nan if p is None else float(p) for p in stated]


def hearts_table(groups: Sequence[HeartGroup]) -> Rows:
    """One column a group, one row a figure."""
    figures: dict[str, Callable[[HeartGroup], str]] = {
        "hearts": lambda g: str(g.hearts),
        "trials (failed)": lambda g: f"{g.trials} ({g.failed})",
        "below 2 mm": lambda g: share_text(g.success),
        "TRE median mm": lambda g: estimate_text(g.tre_median_mm),
        "TRE p95 mm": lambda g: estimate_text(g.tre_p95_mm),
        "per-target p95 mm": lambda g: estimate_text(g.target_p95_mm),
        "covered part below 2 mm": lambda g: share_text(g.covered_success),
        "covered part median mm": lambda g: estimate_text(g.covered_median_mm),
        "TRE with true matches, median mm": lambda g: estimate_text(g.floor_median_mm),
        "TRE with true matches, p95 mm": lambda g: estimate_text(g.floor_p95_mm),
        "above 3 mm refused": lambda g: share_text(g.bad_refused),
        "below 2 mm refused": lambda g: share_text(g.good_refused),
        "chi² of 6, mean": lambda g: estimate_text(g.chi2_mean),
        "95 % region covers": lambda g: share_text(g.region_covers),
        "TRE bound covers": lambda g: share_text(g.bound_covers),
        "TRE bound median mm": lambda g: number_text(g.bound_median_mm),
        "calibration error": lambda g: number_text(g.calibration_error),
        "by chance alone": lambda g: number_text(g.calibration_error_by_chance),
        "AUC": lambda g: number_text(g.auc),
        "outside calibration": lambda g: str(g.outside),
        "seconds": lambda g: number_text(g.seconds_median),
    }
    if any(group.margins for group in groups):
        figures |= {"used": lambda g: share_text(g.used), "followed": lambda g: share_text(g.followed)}
        figures |= {label: partial(_wall_text, name) for name, label in WALLS.items()}
        figures["violation p95 without, fixed, adaptive margin, mm"] = _margins_text
    rows = [(label, *(figure(g) for g in groups)) for label, figure in figures.items()]
    return [("", *(_heading(g) for g in groups)), *rows]


def _wall_text(name: str, group: HeartGroup) -> str:
    return estimate_text(group.walls[name])


def _margins_text(group: HeartGroup) -> str:
    if group.margins is None:
        return "–"
    of = group.margins
    return f"{of.without_mm:.2f}, {of.fixed_mm:.2f}, {of.adaptive_mm:.2f} (mean margin {of.mean_mm:.2f})"


def _heading(group: HeartGroup) -> str:
    more = [", disturbed"] if group.disturbed else []
    return f"{group.images}, {group.quality}" + "".join([*more, f", {group.change}" if group.change else ""])
