"""Figure of the training study: cost above its minimum against iterations and time (Ren 2008, eq. 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.report.style import GUIDE, SERIES, png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXACT = "exact"
STYLES = {"gradient descent": "-", "conjugate gradients": "--", EXACT: ":"}
FLOOR = 1e-9
"""Smallest excess that is drawn."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrainingCurve:
    """Convergence of one method on the network of one degree.

    Attributes:
        method: "gradient descent", "conjugate gradients" or "exact".
        degree: of the B-splines.
        iteration, seconds: (n,) increasing; one entry for the exact solution.
        excess: (n,) (cost − minimal cost) / minimal cost.
    """

    method: str
    degree: int
    iteration: FloatArray
    seconds: FloatArray
    excess: FloatArray


def training_png(curves: Sequence[TrainingCurve], title: str) -> bytes:
    """The figure as a PNG file's bytes."""
    return png_bytes(training_figure(curves, title), dpi=100)


def training_figure(curves: Sequence[TrainingCurve], title: str) -> Figure:
    """Excess cost against iterations and against time; the exact solution is a vertical line at its time."""
    figure = Figure(figsize=(14.0, 4.8), layout="constrained")
    by_iteration, by_time = figure.subplots(1, 2, sharey=True)
    for curve in curves:
        color = SERIES[curve.degree - 1]
        label = f"degree {curve.degree}, {curve.method}"
        if curve.method == EXACT:
            by_time.axvline(curve.seconds[-1], color=color, ls=STYLES[EXACT], label=label)
            continue
        for axes, along in ((by_iteration, curve.iteration), (by_time, curve.seconds)):
            axes.plot(along, curve.excess.clip(FLOOR), STYLES[curve.method], color=color, label=label)
    by_iteration.set(xlabel="iterations", ylabel="(cost − minimum) / minimum (dotted: 1 %)")
    by_time.set(xlabel="time, s")
    for axes in (by_iteration, by_time):
        _style(axes)
    handles, labels = by_time.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    figure.suptitle(title)
    return figure


def _style(axes: Axes) -> None:
    axes.set(xscale="log", yscale="log")
    axes.axhline(0.01, color=GUIDE, ls=":", lw=0.8)
    axes.grid(alpha=0.3)
