"""The figures of a replay. Blue is estimated, orange is the start or pending, black is the ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dvf_ig.core.arrays import BoolArray, FloatArray
from dvf_ig.report.plane_contour import draw_contour, image_extent
from dvf_ig.report.plane_overlay import PlaneOverlay
from dvf_ig.report.style import ESTIMATE, ON_GREY, REFUSED, START, SUSPENDED, TRUTH, without_ticks

from .values import BeatTrace, EcgStrip, RegistrationMark, SupervisorTrace, TickTrace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDE = (10.5, 2.6)
THIN = slice(None, None, 5)
"""Ticks of the force trace that are drawn."""
LARGEST_SHOWN_N = 0.65
GOOD_TRE_MM = 2.0


def overlay_figure(overlays: Sequence[PlaneOverlay]) -> Figure | None:
    """Ultrasound with the model's surface before and after registration, the model's plane beneath.

    None without frames.
    """
    if not overlays:
        return None
    figure = Figure(figsize=(10.5, 5.6), layout="constrained")
    axes = figure.subplots(2, len(overlays), squeeze=False)
    for column, overlay in enumerate(overlays):
        _draw_overlay(axes[:, column], overlay)
    axes[0, 0].set_ylabel("ultrasound")
    axes[1, 0].set_ylabel("model at the same place")
    handles = [
        axes[0, 0].plot([], [], color=color, lw=1.6, label=label)[0]
        for color, label in ((START, "surface at the start pose"), (ON_GREY, "surface after registration"))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _draw_overlay(axes: NDArray[np.object_], overlay: PlaneOverlay) -> None:
    extent = image_extent(overlay.size_mm)
    axes[0].imshow(overlay.image, cmap="gray", extent=extent, vmin=0, vmax=255)
    axes[1].imshow(np.nan_to_num(overlay.registered.grey), cmap="gray", extent=extent, vmin=0, vmax=1)
    for plane, color in ((overlay.start, START), (overlay.registered, ON_GREY)):
        for axis in axes:
            draw_contour(axis, plane.distance_mm, overlay.size_mm, color)
    axes[0].set_title(overlay.moment, fontsize=9)
    without_ticks(*axes)


def pose_figure(
    beats: BeatTrace | None, registrations: Sequence[RegistrationMark], span_s: tuple[float, float]
) -> Figure | None:
    """Every beat's best pose: its error where the ground truth is known, and how much better it explains
    the beat than the pose in use; None without beats."""
    if beats is None:
        return None
    figure = Figure(figsize=(WIDE[0], 4.2), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    if beats.tre_mm is not None:
        _by_use(upper, beats, beats.tre_mm)
        upper.axhline(GOOD_TRE_MM, color=TRUTH, lw=0.8, ls=":")
    upper.set_ylabel("mean TRE, mm")
    upper.margins(y=0.1)
    upper.set_ylim(bottom=0)
    _by_use(lower, beats, beats.log_likelihood_ratio)
    lower.axhline(beats.limit, color=TRUTH, lw=0.8, ls=":")
    lower.set(ylabel="log-likelihood\nratio", xlabel="time, s", xlim=span_s)
    for axis in (upper, lower):
        for begin_s, end_s in beats.suspended_s:
            axis.axvspan(begin_s, end_s, color=SUSPENDED, lw=0, zorder=0)
        for mark in registrations:
            axis.axvline(mark.ready_s, color=TRUTH, lw=0.6, ls="-" if mark.usable else ":")
    figure.legend(*lower.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _by_use(axis: Axes, beats: BeatTrace, values: FloatArray) -> None:
    times, in_use = beats.decided_s, beats.in_use
    axis.plot(times[in_use], values[in_use], "o", ms=3, color=ESTIMATE, label="pose in use")
    axis.plot(
        times[~in_use], values[~in_use], "o", ms=3, mfc="none", color=START, label="pose pending, no force"
    )


def phase_error_figure(ticks: TickTrace) -> Figure | None:
    """Phase error against time; None without ground truth."""
    if ticks.phase_error_percent is None:
        return None
    figure = Figure(figsize=WIDE, layout="constrained")
    axis = figure.subplots()
    error = np.where(ticks.phase_valid, ticks.phase_error_percent, np.nan)
    axis.plot(ticks.t_s, error, color=ESTIMATE, lw=0.8)
    axis.axhline(0, color=TRUTH, lw=0.6)
    axis.set(ylabel="phase error, % of RR", xlabel="time, s")
    axis.margins(x=0)
    shade_refused(axis, ticks.t_s, ticks.valid)
    return figure


def force_figure(ticks: TickTrace) -> Figure:
    """Size of the force and distance to the surface against time."""
    t_s = ticks.t_s[THIN]
    figure = Figure(figsize=(WIDE[0], 3.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for force, distance, color, label in (
        (ticks.true_force_n, ticks.true_distance_mm, TRUTH, "ground truth"),
        (ticks.force_n, ticks.distance_mm, ESTIMATE, "estimated"),
    ):
        if force is not None:
            upper.plot(t_s, force[THIN], color=color, lw=0.8, label=label)
        if distance is not None:
            lower.plot(t_s, distance[THIN], color=color, lw=0.8)
    upper.set(ylabel="force, N", ylim=(0, LARGEST_SHOWN_N))
    lower.set(ylabel="distance, mm\n(inside > 0)", xlabel="time, s", ylim=(-15, 5))
    lower.axhline(0, color=TRUTH, lw=0.6, ls=":")
    lower.set_xlim(float(ticks.t_s[0]), float(ticks.t_s[-1]))
    for axis in (upper, lower):
        shade_refused(axis, ticks.t_s, ticks.valid)
    figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def supervisor_figure(trace: SupervisorTrace) -> Figure:
    """States and hazards as bands over time, and the age of the pose."""
    rows = len(trace.bands)
    figure = Figure(figsize=(WIDE[0], 1.9 + 0.24 * rows), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(max(rows, 1), 5))
    for row, (_, color, held) in enumerate(trace.bands):
        edges = np.flatnonzero(np.diff(held, prepend=False, append=False))
        ends_s = np.append(trace.t_s, trace.t_s[-1])[edges]
        spans = [(begin, end - begin) for begin, end in zip(ends_s[::2], ends_s[1::2], strict=True)]
        upper.broken_barh(spans, (row - 0.4, 0.8), color=color, lw=0.6)
    upper.set_yticks(range(rows), [name for name, _, _ in trace.bands], fontsize=9)
    upper.set_ylim(rows - 0.4, -0.6)
    age_s = np.where(np.isfinite(trace.pose_age_s), trace.pose_age_s, np.nan)
    lower.plot(trace.t_s[THIN], age_s[THIN], color=ESTIMATE, lw=0.8)
    lower.axhline(trace.age_limit_s, color=TRUTH, lw=0.8, ls=":")
    lower.set(ylabel="pose age, s", xlabel="time, s", ylim=(0, 1.6 * trace.age_limit_s))
    lower.set_xlim(float(trace.t_s[0]), float(trace.t_s[-1]))
    return figure


def distance_histogram(ticks: TickTrace) -> Figure:
    """How many ticks the tip spent at each distance from the surface, while a force was given."""
    figure = Figure(figsize=(5.6, 3.0), layout="constrained")
    axis = figure.subplots()
    bins = np.linspace(-10, 5, 61).tolist()
    axis.hist(ticks.distance_mm[ticks.valid], bins=bins, color=ESTIMATE, alpha=0.7, label="estimated")
    if ticks.true_distance_mm is not None:
        axis.hist(
            ticks.true_distance_mm[ticks.valid],
            bins=bins,
            histtype="step",
            color=TRUTH,
            lw=1.2,
            label="ground truth",
        )
    axis.axvline(0, color=TRUTH, lw=0.8, ls=":")
    axis.set(xlabel="distance from the surface, mm (inside > 0)", ylabel="ticks of 1 ms")
    axis.legend(fontsize=9, frameon=False)
    return figure


def ecg_figure(strip: EcgStrip) -> Figure:
    """The ECG or trigger with detected R peaks, and the phase kept from them."""
    figure = Figure(figsize=(WIDE[0], 3.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    if strip.ecg is None:
        upper.vlines(strip.ecg_t_s, 0.0, 1.0, color=TRUTH, lw=0.8)
        upper.set_yticks([])
        height = np.zeros(len(strip.r_peaks_s))
    else:
        upper.plot(strip.ecg_t_s, strip.ecg, color=TRUTH, lw=0.8)
        height = np.interp(strip.r_peaks_s, strip.ecg_t_s, strip.ecg)
    upper.plot(strip.r_peaks_s, height, "o", ms=5, mfc="none", color=ESTIMATE, label="R peak, as detected")
    upper.set_ylabel(strip.label)
    lower.plot(strip.t_s, strip.phase, ".", ms=1, color=ESTIMATE)
    if strip.true_phase is not None:
        lower.plot(strip.t_s, strip.true_phase, ".", ms=0.6, color=TRUTH)
    lower.plot([], [], color=ESTIMATE, label="phase estimated")
    if strip.true_phase is not None:
        lower.plot([], [], color=TRUTH, label="phase by the ground truth")
    lower.set(
        ylabel="phase φ", xlabel="time, s", ylim=(0, 1), xlim=(float(strip.t_s[0]), float(strip.t_s[-1]))
    )
    shade_refused(lower, strip.t_s, strip.phase_valid)
    handles = [*upper.get_legend_handles_labels()[0], *lower.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


def shade_refused(axis: Axes, t_s: FloatArray, valid: BoolArray) -> None:
    """Grey where `valid` (n,) is False."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], valid, [True]]).astype(np.int8)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        axis.axvspan(t_s[begin], t_s[min(end, len(t_s) - 1)], color=REFUSED, lw=0, zorder=0)
