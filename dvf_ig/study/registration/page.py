"""What the page of the registration study shows, counted from its trials."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

import dvf_ig
from dvf_ig.io import write_text
from dvf_ig.report.study.registration import (
    CapturePage,
    Reliability,
    RocCurve,
    SuccessCurve,
    TrialGroup,
    capture_html,
)
from dvf_ig.report.study.registration.values import OURS, Limits
from dvf_ig.study.share import share_of
from dvf_ig.study.trials import Line

from .capture import CAPTURE_PERCENT, capture_of
from .experiments import BIN_MM
from .line import FAILURE_MM, STRICT_MM, SUCCESS_MM, error_of, number
from .summary import (
    Group,
    auc_of,
    group_key,
    summarise_trials,
)

NEAR_MM = 12.0
"""Starts up to here have a column of their own: what a registration is given after touched landmarks."""


def write_capture_page(lines: Iterable[Line], path: Path) -> None:
    """Write the page of these trials: a table and figures for each experiment, then the self-check of all.

    Raises:
        OutputError: `path` cannot be written.
    """
    write_text(path, capture_html(capture_page(list(lines))))


def capture_page(lines: Sequence[Line]) -> CapturePage:
    """Groups and curves of these trials."""
    groups = summarise_trials(lines)
    near = {_key(group): group.success for group in summarise_trials(lines, up_to_mm=NEAR_MM)}
    errors: dict[tuple[str, ...], list[float]] = {}
    for line in lines:
        errors.setdefault(group_key(line), []).append(error_of(line))
    methods = methods_of(lines)
    return CapturePage(
        version=dvf_ig.__version__,
        limits=Limits(STRICT_MM, SUCCESS_MM, FAILURE_MM, NEAR_MM, BIN_MM, CAPTURE_PERCENT),
        methods=methods,
        groups=tuple(
            TrialGroup(group, near.get(_key(group)), _not_refused(errors[_key(group)]))
            for group in groups
            if group.method
        ),
        refused=sum(group.n for group in groups if not group.method),
        success=success_curves(lines),
        roc=tuple(filter(None, (roc_curve(name, lines) for name in methods))),
        reliability=tuple(filter(None, (reliability(name, lines) for name in methods))),
    )


def methods_of(lines: Iterable[Line]) -> tuple[str, ...]:
    """Ours first, then as they appear."""
    names = dict.fromkeys(str(line["method"]) for line in lines if line.get("method"))
    return tuple(sorted(names, key=lambda name: name != OURS))


def success_curves(lines: Iterable[Line]) -> tuple[SuccessCurve, ...]:
    """One curve an experiment, method, quality and condition; motions are pooled."""
    kinds: dict[tuple[str, str, str, str], list[Line]] = {}
    for line in lines:
        if line.get("method"):
            experiment, _, quality, method, condition = group_key(line)
            kinds.setdefault((experiment, method, quality, condition), []).append(line)
    return tuple(SuccessCurve(*kind, capture_of(runs).bins) for kind, runs in kinds.items())


def roc_curve(method: str, lines: Iterable[Line]) -> RocCurve | None:
    """Flags by every limit of the success probability; None without failures, successes and probabilities."""
    runs = [line for line in lines if line.get("method") == method]
    bad, good = _outcomes(runs, "success_probability")
    area = auc_of(bad, good)
    if area is None:
        return None
    limits = np.concatenate([[-1.0], np.unique([*bad, *good])])
    refused, caught = (
        np.searchsorted(np.sort(values), limits, side="right") / len(values) * 100 for values in (good, bad)
    )
    failures = len(bad)
    bad, good = _outcomes(runs, "usable")
    chosen = None
    if bad and good:
        chosen = (100 - 100 * float(np.mean(good)), 100 - 100 * float(np.mean(bad)))
    return RocCurve(method, refused, caught, area, failures, chosen)


def reliability(method: str, lines: Iterable[Line]) -> Reliability | None:
    """Share of successes in each tenth of the stated probability; None where none is stated."""
    runs = [
        (number(line, "success_probability"), error_of(line) < SUCCESS_MM)
        for line in lines
        if line.get("method") == method and math.isfinite(number(line, "success_probability"))
    ]
    if not runs:
        return None
    stated, succeeded = np.array([p for p, _ in runs]), np.array([good for _, good in runs])
    tenth = np.minimum((10 * stated).astype(int), 9)
    present = np.unique(tenth)
    mean = np.array([stated[tenth == t].mean() for t in present])
    shares = tuple(share_of(int(succeeded[tenth == t].sum()), int((tenth == t).sum())) for t in present)
    return Reliability(method, stated, mean, shares)


def _outcomes(lines: Iterable[Line], name: str) -> tuple[list[float], list[float]]:
    """The field's values of failures and of successes, where it has one."""
    bad: list[float] = []
    good: list[float] = []
    for line in lines:
        value, error = number(line, name), error_of(line)
        if math.isfinite(value) and error > FAILURE_MM:
            bad.append(value)
        elif math.isfinite(value) and error < SUCCESS_MM:
            good.append(value)
    return bad, good


def _not_refused(errors_mm: Sequence[float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([error for error in errors_mm if not math.isnan(error)], dtype=np.float64)


def _key(group: Group) -> tuple[str, ...]:
    return (group.experiment, group.motion, group.quality, group.method, group.condition)
