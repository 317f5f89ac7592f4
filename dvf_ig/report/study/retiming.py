"""Figure of the retiming study: error of the surface shown against heart rate, for each way of retiming."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import fmean
from typing import Protocol

from matplotlib.figure import Figure

from dvf_ig.report.style import ESTIMATE, GUIDE, START, TRUTH

COLORS = {"not retimed": GUIDE, "uniform": START, "two-segment": ESTIMATE}


class RetimingRow(Protocol):
    """One method at one heart rate on a heart whose systole shortens by one slope."""

    @property
    def rate_bpm(self) -> float: ...
    @property
    def true_slope_s_per_bpm(self) -> float: ...
    @property
    def method(self) -> str: ...
    @property
    def p95_mm(self) -> float: ...
    @property
    def systole_p95_mm(self) -> float: ...


def retiming_figure(
    rows: Sequence[RetimingRow], *, model_rate_bpm: float, assumed_slope_s_per_bpm: float
) -> Figure:
    """p95 surface error against heart rate: whole cycle, and systole.

    Args:
        rows: of all methods, rates and slopes; methods are drawn in the order of COLORS.
        model_rate_bpm: heart rate of the pre-operative cycle.
        assumed_slope_s_per_bpm: of the two-segment method. Hearts of this slope are left out: what it is told
            is no result. Curves are the mean over the other slopes, bands their range.
    """
    figure = Figure(figsize=(9.5, 4.3), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    rates = sorted({row.rate_bpm for row in rows})
    for method, color in COLORS.items():
        mine = [
            row
            for row in rows
            if row.method == method and row.true_slope_s_per_bpm != assumed_slope_s_per_bpm
        ]
        values: tuple[Callable[[RetimingRow], float], ...] = (
            lambda row: row.p95_mm,
            lambda row: row.systole_p95_mm,
        )
        for axis, value in zip((left, right), values, strict=True):
            at = [[value(row) for row in mine if row.rate_bpm == rate] for rate in rates]
            low, high = [min(v) for v in at], [max(v) for v in at]
            axis.fill_between(rates, low, high, color=color, alpha=0.18, lw=0)
            axis.plot(rates, [fmean(v) for v in at], "o-", clip_on=False, color=color, label=method)
    left.set(ylabel="p95 surface error, mm", title="whole cycle")
    right.set(title="systole")
    for axis in (left, right):
        axis.axvline(model_rate_bpm, color=TRUTH, lw=0.8, ls=":")
        axis.set_xlabel("heart rate, beats/min (dotted: the model's own)")
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.25, lw=0.5)
    figure.legend(
        *left.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=3,
        frameon=False,
        title="mean and range of hearts whose systole shortens a third less and a third more than assumed",
    )
    return figure
