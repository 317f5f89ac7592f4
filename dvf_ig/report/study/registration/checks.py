"""Whether registrations that failed were known as failures, each one figure."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from dvf_ig.report.style import GUIDE

from .capture import in_percent
from .values import Limits, Reliability, RocCurve


def roc_figure(curves: Sequence[RocCurve], colors: dict[str, str], limits: Limits) -> Figure | None:
    """Failures caught against good registrations refused; the ring is the limit in use.

    None without curves.
    """
    if not curves:
        return None
    figure = Figure(figsize=(5.1, 4.7), layout="constrained")
    axis = figure.subplots()
    for curve in curves:
        color = colors[curve.method]
        label = f"{curve.method}: area {curve.area:.3f} ({curve.failures} failures)"
        axis.plot(curve.refused_percent, curve.caught_percent, color=color, lw=1.8, label=label)
        if curve.chosen_percent is not None:
            axis.plot(*curve.chosen_percent, "o", ms=9, mfc="none", mec=color, mew=2)
    axis.plot([0, 100], [0, 100], color=GUIDE, lw=0.8, ls=":")
    axis.set(xlim=(-2, 102), ylim=(-2, 102), aspect="equal")
    axis.set_xlabel(f"good registrations refused (error below {limits.success_mm:.0f} mm), %")
    axis.set_ylabel(f"failures caught (error above {limits.failure_mm:.0f} mm), %")
    axis.grid(alpha=0.25, lw=0.5)
    axis.legend(loc="lower right", fontsize=9, frameon=False)
    return figure


def reliability_figure(
    curves: Sequence[Reliability], colors: dict[str, str], limits: Limits
) -> Figure | None:
    """Share of successes against the probability stated, in tenths; below, how often each was stated.

    Bars are Wilson 95 % intervals. None without curves.
    """
    if not curves:
        return None
    figure = Figure(figsize=(5.1, 4.7), layout="constrained")
    axis, counts = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    for curve in curves:
        axis.errorbar(
            100 * curve.mean_stated,
            *in_percent(curve.success),
            color=colors[curve.method],
            marker="o",
            ms=4.5,
            lw=1.5,
            elinewidth=0.9,
            capsize=2,
            label=curve.method,
        )
        counts.hist(100 * curve.stated, bins=list(range(0, 101, 10)), color=colors[curve.method], alpha=0.6)
    axis.plot([0, 100], [0, 100], color=GUIDE, lw=0.8, ls=":", zorder=0)
    axis.set(xlim=(-2, 102), ylim=(-3, 103))
    axis.set_ylabel(f"runs below {limits.success_mm:.0f} mm, %")
    axis.legend(loc="upper left", fontsize=9, frameon=False)
    counts.set(xlabel="success probability stated, %", ylabel="runs", yscale="log")
    for panel in (axis, counts):
        panel.grid(alpha=0.25, lw=0.5)
    return figure
