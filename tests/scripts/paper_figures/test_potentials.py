"""Figs 8, 9 and 10: what the curves must show, read from the lines that were drawn."""

import numpy as np
import pytest

from dvf_ig.core import FloatArray
from scripts.paper_figures import exponent_figure, steepness_figure, width_figure
from scripts.paper_figures.potentials import (
    AT_WIDTH_N,
    CAP_N,
    EXPONENTS,
    STEEPNESS_PER_MM,
    WIDTH_MM,
    WIDTHS_MM,
)


def curves(figure) -> dict[str, tuple[FloatArray, FloatArray]]:
    (axis,) = figure.axes
    named = [line for line in axis.lines if not line.get_label().startswith("_")]
    return {line.get_label(): line.get_data() for line in named}


def test_gamma_curves_cross_one_half_at_the_surface_and_steepen() -> None:
    drawn = curves(steepness_figure())
    assert list(drawn) == [f"γ = {gamma:g} /mm" for gamma in STEEPNESS_PER_MM]
    slopes = []
    for d, f in drawn.values():
        assert np.interp(0.0, d, f) == pytest.approx(0.5 * CAP_N)
        assert (np.diff(f) > 0).all(), "more force the deeper inside"
        slopes.append(np.interp(0.1, d, f) - np.interp(-0.1, d, f))
    # the slope at the surface is γF/4
    assert np.array(slopes) / 0.2 == pytest.approx(CAP_N * np.array(STEEPNESS_PER_MM) / 4, rel=0.02)


def test_m_curves_meet_at_delta_and_flatten_inside() -> None:
    drawn = curves(exponent_figure())
    assert list(drawn) == [f"m = {m:g}" for m in EXPONENTS]
    at = {m: {x: float(np.interp(x, *c)) for x in (0.0, 0.2, 0.6, WIDTH_MM, 1.5)} for m, c in
          zip(EXPONENTS, drawn.values(), strict=True)}  # fmt: skip
    for values in at.values():
        assert values[0.0] == 0.0
        assert values[WIDTH_MM] == pytest.approx(AT_WIDTH_N, abs=1e-9)
    for x, order in ((0.2, -1), (0.6, -1), (1.5, 1)):
        heights = [at[m][x] for m in EXPONENTS]
        assert heights == sorted(heights, reverse=order < 0), "flatter within δ, steeper beyond"


def test_delta_curves_widen() -> None:
    drawn = curves(width_figure())
    assert list(drawn) == [f"δ = {delta:g} mm" for delta in WIDTHS_MM]
    for delta, (d, f) in zip(WIDTHS_MM, drawn.values(), strict=True):
        assert np.interp(delta, d, f) == pytest.approx(AT_WIDTH_N, abs=1e-9)
        assert np.interp(-delta, d, f) == pytest.approx(AT_WIDTH_N, abs=1e-9)
    free = [np.ptp(d[f < 0.05 * CAP_N]) for d, f in drawn.values()]
    assert free == sorted(free)
    assert np.array(free) / free[0] == pytest.approx(np.array(WIDTHS_MM), rel=0.05), "as wide as δ says"
