"""Capture range and errors of the registration study, each one figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator, NullLocator

from dvf_ig.core.arrays import FloatArray
from dvf_ig.report.style import GUIDE, SERIES, TRUTH, open_frame

from .values import OURS, Limits, Share, SuccessCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DASHES = ("-", "--", ":", "-.")
MARKERS = ("o", "s", "^", "D")
TOP_MM = 30.0
"""Errors from here on share the last place of the axis."""


def colors_of(methods: Iterable[str]) -> dict[str, str]:
    """One colour a method, the same in every figure; ours is blue."""
    others = [name for name in methods if name != OURS]
    shades = {name: SERIES[1 + place % (len(SERIES) - 1)] for place, name in enumerate(others)}
    return {OURS: SERIES[0], **shades}


def capture_curves(curves: Sequence[SuccessCurve], colors: dict[str, str], limits: Limits) -> Figure | None:
    """Success against start error, one panel a condition; bars are Wilson 95 % intervals.

    One line a method and quality. None without starts.
    """
    shown = [curve for curve in curves if curve.bins]
    if not shown:
        return None
    conditions = list(dict.fromkeys(curve.condition for curve in shown))
    qualities = list(dict.fromkeys(curve.quality for curve in shown))
    methods = [name for name in colors if any(curve.method == name for curve in shown)]
    kinds = [(method, quality) for method in methods for quality in qualities]
    columns = min(3, len(conditions))
    rows = math.ceil(len(conditions) / columns)
    width, height = (8.6, 3.9) if columns == 1 else (10.5, 3.1 * rows + 0.5)
    figure = Figure(figsize=(width, height), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    of_condition = dict(zip(conditions, panels.ravel(), strict=False))
    for curve in sorted(shown, key=lambda curve: kinds.index((curve.method, curve.quality))):
        # curves lie beside each other, so that their bars can be told apart
        place = kinds.index((curve.method, curve.quality))
        look = qualities.index(curve.quality) % len(DASHES)
        shift_mm = 0.12 * (place - (len(kinds) - 1) / 2)
        _curve(of_condition[curve.condition], curve, shift_mm, colors[curve.method], look)
    for condition, panel in of_condition.items():
        _capture_axes(panel, condition if len(conditions) > 1 else "", limits)
    for panel in panels.ravel()[len(conditions) :]:
        panel.set_visible(False)
    for panel in panels[:, 0]:
        panel.set_ylabel(f"runs below {limits.success_mm:.0f} mm, %")
    for panel in panels.ravel()[: len(conditions)][-columns:]:
        panel.set_xlabel("error of the start, mm")
    handles, labels = _labels(panels.ravel())
    figure.legend(handles, labels, loc="outside lower center", ncols=len(methods), frameon=False, fontsize=9)
    return figure


def _curve(axis: Axes, curve: SuccessCurve, shift_mm: float, color: str, look: int) -> None:
    axis.errorbar(
        [(entry.low_mm + entry.high_mm) / 2 + shift_mm for entry in curve.bins],
        *in_percent([entry.success for entry in curve.bins]),
        color=color,
        ls=DASHES[look],
        marker=MARKERS[look],
        ms=4.5,
        lw=1.7,
        elinewidth=0.9,
        capsize=2,
        label=" · ".join(filter(None, (curve.method, curve.quality))),
    )


def in_percent(shares: Iterable[Share]) -> tuple[FloatArray, FloatArray]:
    """(k,) shares of something in percent, and (2, k) how far their intervals reach down and up."""
    rows = np.array([(s.share, s.low, s.high) for s in shares], dtype=np.float64) * 100
    return rows[:, 0], np.abs(rows[:, 1:] - rows[:, :1]).T


def _capture_axes(axis: Axes, title: str, limits: Limits) -> None:
    axis.axhline(limits.captured_percent, color="#444444", lw=0.9, ls=":")
    axis.set(ylim=(-3, 103), xlim=(0, None), title=title)
    axis.xaxis.set_major_locator(MultipleLocator(2 * limits.bin_mm))
    axis.tick_params(labelbottom=True)
    axis.title.set_fontsize(10)
    axis.grid(alpha=0.25, lw=0.5)
    open_frame(axis)


def _labels(panels: Iterable[Axes]) -> tuple[list[Any], list[str]]:
    found: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)


def error_boxes(
    entries: Sequence[tuple[str, str, FloatArray]], colors: dict[str, str], limits: Limits
) -> Figure | None:
    """Errors of all runs, one box a group: quartiles, whiskers from 5 to 95 %, the rest as dots.

    Args:
        entries: label, method and errors (k,) in mm of each group, from the top down; groups without errors
            are left out.
        colors: see colors_of.
        limits: dotted lines.
    """
    shown = [entry for entry in entries if len(entry[2])]
    if not shown:
        return None
    figure = Figure(figsize=(10.5, 1.2 + 0.34 * len(shown)), layout="constrained")
    axis = figure.subplots()
    places = list(range(len(shown), 0, -1))
    for place, (_, method, errors) in zip(places, shown, strict=True):
        _box(axis, place, np.minimum(errors, TOP_MM), colors.get(method, GUIDE))
    axis.set_yticks(places, [f"{label}  (n = {len(errors)})" for label, _, errors in shown], fontsize=9)
    axis.set_ylim(0.4, len(shown) + 0.6)
    _error_axis(axis, limits)
    return figure


def _box(axis: Axes, place: int, errors: FloatArray, color: str) -> None:
    p5, p25, p50, p75, p95 = np.percentile(errors, (5, 25, 50, 75, 95))
    axis.hlines(place, p5, p95, color=TRUTH, lw=1.0)
    axis.vlines((p5, p95), place - 0.15, place + 0.15, color=TRUTH, lw=1.0)
    axis.barh(place, p75 - p25, left=p25, height=0.6, color=color, edgecolor=TRUTH, lw=0.7, zorder=2)
    axis.vlines(p50, place - 0.3, place + 0.3, color="#ffffff", lw=2.0, zorder=3)
    beyond = errors[(errors < p5) | (errors > p95)]
    axis.plot(beyond, np.full(len(beyond), place), ".", ms=4, mec="none", mfc="#555555", alpha=0.6)


def _error_axis(axis: Axes, limits: Limits) -> None:
    for limit in (limits.success_mm, limits.failure_mm):
        axis.axvline(limit, color=GUIDE, lw=0.9, ls=":", zorder=0)
    ticks = (0.2, 0.5, 1, 2, 3, 5, 10, 20, TOP_MM)
    axis.set_xscale("log")
    axis.set_xticks(ticks, [*(f"{tick:g}" for tick in ticks[:-1]), f"≥ {TOP_MM:g}"])
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set(xlim=(min(0.2, axis.get_xlim()[0]), 1.1 * TOP_MM))
    axis.set_xlabel("mean error over the heart of one registration, mm (all runs, failures included)")
    axis.grid(axis="x", alpha=0.25, lw=0.5)
    open_frame(axis)
