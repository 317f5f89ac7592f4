"""Draw force against distance: Ren 2008, Figs 8 (γ), 9 (m) and 10 (δ)."""

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
WIDTH_MM, EXPONENT = 1.0, 2.0
"""δ of the curves with different m, and m of the curves with different δ."""
CAP_N = 0.6
"""Largest force, as in the paper's experiments."""
AT_WIDTH_N = CAP_N * (1.0 - np.exp(-1.0))
"""Force at a distance of δ, for any m."""


def steepness_figure() -> Figure:
    """Draw Fig. 8: force of a forbidden region (eq. 4–6) for several γ."""
    figure, axis = _axes("Forbidden region (eq. 4–6)", "distance d, mm (inside > 0)")
    d = np.linspace(-6.0, 6.0, 601)
    for gamma, color in zip(STEEPNESS_PER_MM, BLUES, strict=True):
        axis.plot(d, CAP_N * Sigmoid(gamma).potential(d), color=color, lw=2.2, label=f"γ = {gamma:g} /mm")
    axis.axvspan(0.0, 6.0, color="#f3e3e3", lw=0, zorder=0)
    axis.annotate("inside the organ", (5.8, 0.02), ha="right", color="#8a4b4b")
    axis.annotate("outside", (-0.2, 0.59), ha="right", color=GUIDE)
    axis.axhline(0.5 * CAP_N, color=GUIDE, lw=0.8, ls=":")
    axis.legend(frameon=False, loc="upper left")
    return figure


def exponent_figure() -> Figure:
    """Draw Fig. 9: force of guidance (eq. 7–9) for several m; the workspace is δ to either side."""
    figure, axis = _axes(f"Guidance (eq. 7–9), workspace ± {WIDTH_MM:g} mm", "distance d from the target, mm")
    d = np.linspace(-3.0, 3.0, 1201)
    for m, color in zip(EXPONENTS, BLUES, strict=True):
        axis.plot(
            d, CAP_N * np.abs(Gaussian(WIDTH_MM, m).potential(d)), color=color, lw=2.2, label=f"m = {m:g}"
        )
    axis.plot([-WIDTH_MM, WIDTH_MM], [AT_WIDTH_N, AT_WIDTH_N], "o", ms=5, color=TRUTH, zorder=5)
    text = f"{AT_WIDTH_N:.2f} N at δ"
    axis.annotate(text, (WIDTH_MM, AT_WIDTH_N), (9, -12), textcoords="offset points")
    axis.legend(frameon=False, loc="lower left")
    return figure


def width_figure() -> Figure:
    """Draw Fig. 10: force of guidance (eq. 7–9) for several δ at one m."""
    figure, axis = _axes(f"Guidance (eq. 7–9), m = {EXPONENT:g}", "distance d from the target, mm")
    d = np.linspace(-8.0, 8.0, 1601)
    for delta, color in zip(WIDTHS_MM, BLUES, strict=True):
        force_n = CAP_N * np.abs(Gaussian(delta, EXPONENT).potential(d))
        axis.plot(d, force_n, color=color, lw=2.2, label=f"δ = {delta:g} mm")
        axis.plot([-delta, delta], [AT_WIDTH_N, AT_WIDTH_N], "o", ms=5, color=color, zorder=5)
    axis.annotate(f"dots: {AT_WIDTH_N:.2f} N at δ", (7.8, 0.02), ha="right")
    axis.legend(frameon=False, loc="lower left")
    return figure


def _axes(title: str, x_label: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.set(xlabel=x_label, ylabel="force, N", ylim=(0.0, 1.05 * CAP_N))
    axis.set_title(title, fontsize=11)
    open_frame(axis)
    axis.margins(x=0.0)
    return figure, axis
