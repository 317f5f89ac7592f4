"""Draw potentials of the force laws against distance: Ren 2008, Figs 8 (γ), 9 (m) and 10 (δ)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from dvf_ig.guidance import Gaussian, Sigmoid
from dvf_ig.report.style import BLUES, GUIDE, TRUTH, open_frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEEPNESS_PER_MM = (0.5, 1.0, 2.0, 4.0)
EXPONENTS = (0.5, 1.0, 2.0, 4.0)
WIDTHS_MM = (1.0, 2.0, 3.0, 4.0)
WIDTH_MM, EXPONENT = 3.0, 2.0
"""δ of the curves with different m, and m of the curves with different δ."""
AT_WIDTH = 1.0 - np.exp(-1.0)
"""Share of the largest force at a distance of δ, for any m."""


def steepness_figure() -> Figure:
    """Draw Fig. 8: sigmoid potential of a forbidden region (eq. 4) for several γ."""
    figure, axis = _axes("Sigmoid potential of a forbidden region (eq. 4)", "distance d, mm (inside > 0)")
    d = np.linspace(-6.0, 6.0, 601)
    for gamma, color in zip(STEEPNESS_PER_MM, BLUES, strict=True):
        axis.plot(d, Sigmoid(gamma).potential(d), color=color, lw=2.2, label=f"γ = {gamma:g} /mm")
    axis.axvspan(0.0, 6.0, color="#f3e3e3", lw=0, zorder=0)
    axis.annotate("inside the organ", (5.8, 0.04), ha="right", color="#8a4b4b")
    axis.annotate("outside", (-0.2, 0.98), ha="right", color=GUIDE)
    axis.axhline(0.5, color=GUIDE, lw=0.8, ls=":")
    axis.legend(frameon=False, loc="upper left")
    return figure


def exponent_figure() -> Figure:
    """Draw Fig. 9: generalised Gaussian potential of guidance (eq. 7) for several m at one δ."""
    figure, axis = _axes(
        f"Gaussian potential of guidance (eq. 7), δ = {WIDTH_MM:g} mm", "distance d from the target, mm"
    )
    d = np.linspace(-8.0, 8.0, 1601)
    for m, color in zip(EXPONENTS, BLUES, strict=True):
        axis.plot(d, np.abs(Gaussian(WIDTH_MM, m).potential(d)), color=color, lw=2.2, label=f"m = {m:g}")
    axis.plot([-WIDTH_MM, WIDTH_MM], [AT_WIDTH, AT_WIDTH], "o", ms=5, color=TRUTH, zorder=5)
    text = f"{100 * AT_WIDTH:.0f} % at δ"
    axis.annotate(text, (WIDTH_MM, AT_WIDTH), (9, -12), textcoords="offset points")
    axis.legend(frameon=False, loc="lower left")
    return figure


def width_figure() -> Figure:
    """Draw Fig. 10: generalised Gaussian potential of guidance (eq. 7) for several δ at one m."""
    figure, axis = _axes(
        f"Gaussian potential of guidance (eq. 7), m = {EXPONENT:g}", "distance d from the target, mm"
    )
    d = np.linspace(-8.0, 8.0, 1601)
    for delta, color in zip(WIDTHS_MM, BLUES, strict=True):
        potential = np.abs(Gaussian(delta, EXPONENT).potential(d))
        axis.plot(d, potential, color=color, lw=2.2, label=f"δ = {delta:g} mm")
        axis.plot([-delta, delta], [AT_WIDTH, AT_WIDTH], "o", ms=5, color=color, zorder=5)
    axis.annotate(f"dots: {100 * AT_WIDTH:.0f} % at δ", (7.8, 0.04), ha="right")
    axis.legend(frameon=False, loc="lower left")
    return figure


def _axes(title: str, x_label: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.set(xlabel=x_label, ylabel="potential f, share of the largest force", ylim=(0.0, 1.05))
    axis.set_title(title, fontsize=11)
    open_frame(axis)
    axis.margins(x=0.0)
    return figure, axis
