"""Whether registrations that failed were known as failures, as pictures, each one figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from dvf_ig.core.arrays import FloatArray
from dvf_ig.study.registration.summary import FAILURE_MM, SUCCESS_MM, auc_of, error_of, number, share_of
from dvf_ig.study.trials import Line

from .registration_capture import GUIDE, in_percent, methods_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def roc_picture(lines: Sequence[Line], colors: dict[str, str]) -> Figure | None:
    """Failures flagged against successes flagged, for every limit of the success probability.

    The ring is where `usable` stands. None where no method has failures, successes and probabilities.
    """
    figure = Figure(figsize=(5.1, 4.7), layout="constrained")
    axis = figure.subplots()
    for method in methods_of(lines):
        runs = [line for line in lines if line.get("method") == method]
        bad, good = _outcomes(runs, "success_probability")
        auc = auc_of(bad, good)
        if auc is None:
            continue
        limits = np.concatenate([[-1.0], np.unique([*bad, *good])])
        wrongly, rightly = (
            np.searchsorted(np.sort(values), limits, side="right") / len(values) * 100
            for values in (good, bad)
        )
        color = colors[method]
        axis.plot(
            wrongly, rightly, color=color, lw=1.8, label=f"{method}: area {auc:.3f} ({len(bad)} failures)"
        )
        bad, good = _outcomes(runs, "usable")
        if bad and good:
            axis.plot(
                100 - 100 * np.mean(good), 100 - 100 * np.mean(bad), "o", ms=9, mfc="none", mec=color, mew=2
            )
    if not axis.lines:
        return None
    axis.plot([0, 100], [0, 100], color=GUIDE, lw=0.8, ls=":")
    axis.set(xlim=(-2, 102), ylim=(-2, 102), aspect="equal")
    axis.set_xlabel(f"good registrations refused (error below {SUCCESS_MM:.0f} mm), %")
    axis.set_ylabel(f"failures caught (error above {FAILURE_MM:.0f} mm), %")
    axis.grid(alpha=0.25, lw=0.5)
    axis.legend(loc="lower right", fontsize=9, frameon=False)
    return figure


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


def calibration_picture(lines: Sequence[Line], colors: dict[str, str]) -> Figure | None:
    """Share of successes against the probability that was told, in tenths; below, how often each was told.

    Bars are Wilson 95 % intervals. None where no method tells a probability.
    """
    figure = Figure(figsize=(5.1, 4.7), layout="constrained")
    axis, counts = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    methods = methods_of(lines)
    for method in methods:
        told = [
            (number(line, "success_probability"), error_of(line) < SUCCESS_MM)
            for line in lines
            if line.get("method") == method and math.isfinite(number(line, "success_probability"))
        ]
        if told:
            _reliability(axis, counts, np.array(told), colors[method], method)
    if not axis.containers:
        return None
    axis.plot([0, 100], [0, 100], color=GUIDE, lw=0.8, ls=":", zorder=0)
    axis.set(xlim=(-2, 102), ylim=(-3, 103))
    axis.set_ylabel(f"runs below {SUCCESS_MM:.0f} mm, %")
    axis.legend(loc="upper left", fontsize=9, frameon=False)
    counts.set(xlabel="success probability told, %", ylabel="runs", yscale="log")
    for panel in (axis, counts):
        panel.grid(alpha=0.25, lw=0.5)
    return figure


def _reliability(axis: Axes, counts: Axes, told: FloatArray, color: str, label: str) -> None:
    """`told`: (n, 2) of probability and whether the run was a success."""
    tenth = np.minimum((10 * told[:, 0]).astype(int), 9)
    present = np.unique(tenth)
    middle = [100 * told[tenth == t, 0].mean() for t in present]
    shares = [share_of(int(told[tenth == t, 1].sum()), int((tenth == t).sum())) for t in present]
    axis.errorbar(
        middle,
        *in_percent(shares),
        color=color,
        marker="o",
        ms=4.5,
        lw=1.5,
        elinewidth=0.9,
        capsize=2,
        label=label,
    )
    counts.hist(100 * told[:, 0], bins=list(range(0, 101, 10)), color=color, alpha=0.6)
