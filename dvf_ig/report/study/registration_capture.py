"""Capture range and errors of the capture study as pictures, each one figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator, NullLocator

from dvf_ig.core.arrays import FloatArray
from dvf_ig.study.registration.experiments import BIN_MM
from dvf_ig.study.registration.summary import (
    CAPTURE_PERCENT,
    FAILURE_MM,
    SUCCESS_MM,
    Share,
    capture_of,
    error_of,
    number,
)
from dvf_ig.study.trials import Line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OURS = "dvf_ig"
OURS_COLOR = "#1f6fb4"
OTHER_COLORS = ("#e07b00", "#2b7a3d", "#8e44ad", "#7f6a55", "#b3261e")
DASHES = ("-", "--", ":", "-.")
MARKERS = ("o", "s", "^", "D")
GUIDE = "#8a8a8a"
TOP_MM = 30.0
"""Errors from here on share the last place of the axis."""


def methods_of(lines: Iterable[Line]) -> list[str]:
    """Ours first, then as they appear."""
    names = dict.fromkeys(str(line.get("method") or "") for line in lines if line.get("method"))
    return sorted(names, key=lambda name: name != OURS)


def colors_of(lines: Iterable[Line]) -> dict[str, str]:
    """One colour a method, the same in every picture."""
    others = [name for name in methods_of(lines) if name != OURS]
    shades = {name: OTHER_COLORS[place % len(OTHER_COLORS)] for place, name in enumerate(others)}
    return {OURS: OURS_COLOR, **shades}


def capture_curves(lines: Sequence[Line], colors: dict[str, str]) -> Figure | None:
    """Success against start error, one panel a condition; bars are Wilson 95 % intervals.

    One line a method and quality; motions are pooled. None without starts.
    """
    known = [line for line in lines if line.get("method") and math.isfinite(number(line, "start_mm"))]
    if not known:
        return None
    conditions = _values(known, "condition")
    columns = min(3, len(conditions))
    rows = math.ceil(len(conditions) / columns)
    width, height = (8.6, 3.9) if columns == 1 else (10.5, 3.1 * rows + 0.5)
    figure = Figure(figsize=(width, height), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    qualities = _values(known, "quality")
    curves = [(method, quality) for method in methods_of(known) for quality in qualities]
    for panel, condition in zip(panels.ravel(), conditions, strict=False):
        for place, (method, quality) in enumerate(curves):
            chosen = [
                line
                for line in known
                if (line["method"], line.get("quality"), line.get("condition"))
                == (method, quality, condition)
            ]
            look = qualities.index(quality) % len(DASHES)
            shift = 0.12 * (place - (len(curves) - 1) / 2)
            _curve(panel, chosen, shift, colors[method], look, " · ".join(filter(None, (method, quality))))
        _capture_axes(panel, str(condition or "") if len(conditions) > 1 else "")
    for panel in panels.ravel()[len(conditions) :]:
        panel.set_visible(False)
    for panel in panels[:, 0]:
        panel.set_ylabel(f"runs below {SUCCESS_MM:.0f} mm, %")
    for panel in panels.ravel()[: len(conditions)][-columns:]:
        panel.set_xlabel("error of the start, mm")
    figure.legend(
        *_labels(panels.ravel()),
        loc="outside lower center",
        ncols=len(methods_of(known)),
        frameon=False,
        fontsize=9,
    )
    return figure


def _curve(axis: Axes, lines: Sequence[Line], shift_mm: float, color: str, look: int, label: str) -> None:
    bins = capture_of(lines).bins
    if not bins:
        return
    middle = [(entry.low_mm + entry.high_mm) / 2 + shift_mm for entry in bins]
    axis.errorbar(
        middle,
        *in_percent([entry.success for entry in bins]),
        color=color,
        ls=DASHES[look],
        marker=MARKERS[look],
        ms=4.5,
        lw=1.7,
        elinewidth=0.9,
        capsize=2,
        label=label,
    )


def in_percent(shares: Iterable[Share]) -> tuple[FloatArray, FloatArray]:
    """Shares of something in percent, and how far their intervals reach down and up."""
    rows = np.array([(s.share, s.low, s.high) for s in shares], dtype=np.float64) * 100
    return rows[:, 0], np.abs(rows[:, 1:] - rows[:, :1]).T


def _capture_axes(axis: Axes, title: str) -> None:
    axis.axhline(CAPTURE_PERCENT, color="#444444", lw=0.9, ls=":")
    axis.set(ylim=(-3, 103), xlim=(0, None), title=title)
    axis.xaxis.set_major_locator(MultipleLocator(2 * BIN_MM))
    axis.tick_params(labelbottom=True)
    axis.title.set_fontsize(10)
    axis.grid(alpha=0.25, lw=0.5)
    axis.spines[["top", "right"]].set_visible(False)


def _labels(panels: Iterable[Axes]) -> tuple[list[Any], list[str]]:
    found: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)


def error_boxes(entries: Sequence[tuple[str, Sequence[Line]]], colors: dict[str, str]) -> Figure | None:
    """Errors of all runs, one box a group: quartiles, whiskers from 5 to 95 %, the rest as dots.

    Args:
        entries: label and runs of each group, from the top down; groups without errors are left out.
        colors: see colors_of.
    """
    shown = [
        (label, [error for error in map(error_of, runs) if not math.isnan(error)], str(runs[0].get("method")))
        for label, runs in entries
    ]
    shown = [entry for entry in shown if entry[1]]
    if not shown:
        return None
    figure = Figure(figsize=(10.5, 1.2 + 0.34 * len(shown)), layout="constrained")
    axis = figure.subplots()
    places = list(range(len(shown), 0, -1))
    for place, (_, errors, method) in zip(places, shown, strict=True):
        _box(axis, place, np.minimum(errors, TOP_MM), colors.get(method, GUIDE))
    axis.set_yticks(places, [f"{label}  (n = {len(errors)})" for label, errors, _ in shown], fontsize=9)
    axis.set_ylim(0.4, len(shown) + 0.6)
    _error_axis(axis)
    return figure


def _box(axis: Axes, place: int, errors: FloatArray, color: str) -> None:
    p5, p25, p50, p75, p95 = np.percentile(errors, (5, 25, 50, 75, 95))
    axis.hlines(place, p5, p95, color="#333333", lw=1.0)
    axis.vlines((p5, p95), place - 0.15, place + 0.15, color="#333333", lw=1.0)
    axis.barh(place, p75 - p25, left=p25, height=0.6, color=color, edgecolor="#333333", lw=0.7, zorder=2)
    axis.vlines(p50, place - 0.3, place + 0.3, color="#ffffff", lw=2.0, zorder=3)
    beyond = errors[(errors < p5) | (errors > p95)]
    axis.plot(beyond, np.full(len(beyond), place), ".", ms=4, mec="none", mfc="#555555", alpha=0.6)


def _error_axis(axis: Axes) -> None:
    for limit in (SUCCESS_MM, FAILURE_MM):
        axis.axvline(limit, color=GUIDE, lw=0.9, ls=":", zorder=0)
    ticks = (0.2, 0.5, 1, 2, 3, 5, 10, 20, TOP_MM)
    axis.set_xscale("log")
    axis.set_xticks(ticks, [*(f"{tick:g}" for tick in ticks[:-1]), f"≥ {TOP_MM:g}"])
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set(xlim=(min(0.2, axis.get_xlim()[0]), 1.1 * TOP_MM))
    axis.set_xlabel("mean error over the heart of one registration, mm (all runs, failures included)")
    axis.grid(axis="x", alpha=0.25, lw=0.5)
    axis.spines[["top", "right"]].set_visible(False)


def _values(lines: Iterable[Line], name: str) -> list[Any]:
    return list(dict.fromkeys(line.get(name) for line in lines))
