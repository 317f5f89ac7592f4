"""Figure of the gating study: phase error against the share of time in which phase is used."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.report.style import ESTIMATE, SERIES, START

COLORS = {"sinus": ESTIMATE, "ectopic": START, "fibrillation": SERIES[3]}
TARGET_P95 = {"sinus": 8.0, "ectopic": 15.0}


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RiskCoverage:
    """Recordings of one rhythm.

    Attributes:
        name: the rhythm.
        kept_share: (k,) shares of the time, 0 to 1, that are kept when phase is refused by σφ alone.
        p95_percent: (k,) 95th percentile of the phase error then, % of RR.
        locked_share, locked_p95_percent: the same where the clock is LOCKED; NaN error where it never is.
    """

    name: str
    kept_share: FloatArray
    p95_percent: FloatArray
    locked_share: float
    locked_p95_percent: float


def risk_coverage_figure(rhythms: Sequence[RiskCoverage]) -> Figure:
    """p95 error against the share of time kept, refusing by σφ; dots: where the clock is LOCKED."""
    figure = Figure(figsize=(7.6, 4.8), layout="constrained")
    axis = figure.subplots()
    for rhythm in rhythms:
        color = COLORS.get(rhythm.name, "#444444")
        label = f"{rhythm.name}: refused by σφ alone"
        axis.plot(100 * rhythm.kept_share, rhythm.p95_percent, color=color, lw=1.6, label=label)
        if not math.isnan(rhythm.locked_p95_percent):
            place = (100 * rhythm.locked_share, rhythm.locked_p95_percent)
            axis.plot(*place, "o", color=color, label=f"{rhythm.name}: LOCKED by the clock")
        if rhythm.name in TARGET_P95:
            axis.axhline(TARGET_P95[rhythm.name], color=color, lw=0.8, ls=":")
    axis.set(
        xlabel="share of the time in which phase is used, % (dotted: the error aimed at)",
        ylabel="p95 of the phase error then, % of RR",
        xlim=(0, 100),
        ylim=(0, 50),
    )
    axis.grid(alpha=0.25, lw=0.5)
    figure.legend(fontsize=9, frameon=False, loc="outside lower center", ncols=max(1, len(rhythms)))
    return figure
