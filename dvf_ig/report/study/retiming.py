"""The picture of `dvf-ig study retiming`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dvf_ig.cardiac import SYSTOLE_SLOPE_S_PER_BPM
from dvf_ig.study.retiming.surface_error import METHODS, RetimingRow

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = dict(zip(METHODS, ("#777777", "#e07b00", "#1f6fb4"), strict=True))


def retiming_figure(rows: Sequence[RetimingRow], model_rate_bpm: float) -> Figure:
    """p95 surface error against heart rate: whole cycle, and systole."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    lawful = [row for row in rows if row.true_slope_s_per_bpm == SYSTOLE_SLOPE_S_PER_BPM]
    rates = sorted({row.rate_bpm for row in rows})
    for method in METHODS:
        color = COLORS[method]
        mine = [row for row in rows if row.method == method]
        for axis, name in ((left, "p95_mm"), (right, "systole_p95_mm")):
            at = [[getattr(row, name) for row in mine if row.rate_bpm == rate] for rate in rates]
            axis.fill_between(
                rates, [min(v) for v in at], [max(v) for v in at], color=color, alpha=0.18, lw=0
            )
            law = [getattr(row, name) for row in lawful if row.method == method]
            axis.plot(rates[: len(law)], law, "o-", color=color, label=method)
    left.set(ylabel="p95 surface error, mm", title="whole cycle")
    right.set(title="systole")
    for axis in (left, right):
        axis.axvline(model_rate_bpm, color="#222222", lw=0.8, ls=":")
        axis.set_xlabel("heart rate, beats/min (dotted: the model's own)")
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.25, lw=0.5)
    left.legend(fontsize=8, frameon=False, title="band: true k a third off", title_fontsize=8)
    return figure
