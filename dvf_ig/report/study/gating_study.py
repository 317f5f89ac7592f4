"""The risk–coverage picture of `dvf-ig study gating`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from dvf_ig.study.gating.records import PhaseErrors, risk_coverage, summarise_phase

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = {"sinus": "#1f6fb4", "ectopic": "#e07b00", "fibrillation": "#b03060"}
TARGET_P95 = {"sinus": 8.0, "ectopic": 15.0}


def risk_coverage_figure(classes: Mapping[str, PhaseErrors]) -> Figure:
    """p95 error against the share of time kept, refusing by σφ; dots are where the clock's states stand."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 4.8), layout="constrained")
    axis = figure.subplots()
    for name, errors in classes.items():
        share, p95, _ = risk_coverage(errors)
        color = COLORS.get(name, "#444444")
        axis.plot(100 * share, p95, color=color, lw=1.6, label=f"{name}: refused by σφ alone")
        now = summarise_phase([errors])
        if now.p95_percent == now.p95_percent:
            axis.plot(
                100 * now.valid_share, now.p95_percent, "o", color=color, label=f"{name}: LOCKED by the clock"
            )
        if name in TARGET_P95:
            axis.axhline(TARGET_P95[name], color=color, lw=0.8, ls=":")
    axis.set(
        xlabel="share of the time in which phase is used, %",
        ylabel="p95 of the phase error then, % of RR",
        xlim=(0, 100),
        ylim=(0, 50),
    )
    axis.grid(alpha=0.25, lw=0.5)
    figure.legend(fontsize=8, frameon=False, loc="outside lower center", ncols=len(classes))
    return figure
