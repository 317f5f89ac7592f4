"""Draw the figures of a replay. Blue is estimated, orange is the start or pending, black is the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from dvf_ig.core.arrays import BoolArray, FloatArray
from dvf_ig.report.plane_marks import draw_plane_marks
from dvf_ig.report.plane_overlay import PlaneOverlay, draw_contour, image_extent
from dvf_ig.report.style import (
    ESTIMATE,
    GUIDE,
    ON_GREY,
    REFUSED,
    SERIES,
    START,
    SUSPENDED,
    TRUTH,
    WIDE_IN,
    label_color,
    legend_below,
    open_frame,
    time_axes,
    without_ticks,
)

from .values import BeatTrace, BreathLoop, EcgStrip, RegistrationMark, SupervisorTrace, TickTrace

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

THIN = slice(None, None, 5)
"""Slice of the ticks that are drawn."""
LARGEST_SHOWN_N = 0.65
GOOD_TRE_MM = 2.0
LABEL_TINT = 0.4
RULE_WIDTH = 0.12
"""Share of the time axis that the name of a rule takes; names that would overlap are left out."""


def overlay_figure(overlays: Sequence[PlaneOverlay]) -> Figure | None:
    """Draw ultrasound with the model's surface before and after registration, the model's plane beneath.

    Returns None without frames.
    """
    if not overlays:
        return None
    labelled = any(one.labels is not None and one.labels.any() for one in overlays)
    rows = 3 if labelled else 2
    figure = Figure(figsize=(WIDE_IN, 2.8 * rows), layout="constrained")
    axes = figure.subplots(rows, len(overlays), squeeze=False)
    for column, overlay in enumerate(overlays):
        _draw_overlay(axes[:2, column], overlay)
        if labelled:
            _draw_labels(axes[2, column], overlay)
    axes[0, 0].set_ylabel("ultrasound")
    axes[1, 0].set_ylabel("model in the same plane")
    handles: list[Artist] = [
        axes[0, 0].plot([], [], color=color, lw=1.6, label=label)[0]
        for color, label in ((START, "surface at the start pose"), (ON_GREY, "surface after registration"))
    ]
    if labelled:
        axes[2, 0].set_ylabel("labels after registration")
        handles += _label_handles(overlays)
    figure.legend(handles=handles, loc="outside lower center", ncols=2 if not labelled else 4, frameon=False)
    return figure


def _label_handles(overlays: Sequence[PlaneOverlay]) -> list[Artist]:
    """List the labels that are seen in any of the planes."""
    seen = set().union(*(np.unique(one.labels).tolist() for one in overlays if one.labels is not None))
    names = dict(overlays[0].label_names)
    return [
        Patch(color=label_color(value), label=names.get(value, f"label {value}").replace("_", " "))
        for value in sorted(seen - {0})
    ]


def _draw_labels(axis: Axes, overlay: PlaneOverlay) -> None:
    """Tint the ultrasound by the labels."""
    extent = image_extent(overlay.size_mm)
    axis.imshow(overlay.image, cmap="gray", extent=extent, vmin=0, vmax=255)
    if overlay.labels is not None:
        tint = np.zeros((*overlay.labels.shape, 4))
        for value in np.unique(overlay.labels[overlay.labels != 0]).tolist():
            tint[overlay.labels == value] = to_rgba(label_color(value), LABEL_TINT)
        axis.imshow(tint, extent=extent, interpolation="nearest")
    draw_plane_marks(axis, overlay.size_mm, overlay.registered.edges)
    without_ticks(axis)


def _draw_overlay(axes: NDArray[np.object_], overlay: PlaneOverlay) -> None:
    extent = image_extent(overlay.size_mm)
    axes[0].imshow(overlay.image, cmap="gray", extent=extent, vmin=0, vmax=255)
    axes[1].imshow(np.nan_to_num(overlay.registered.grey), cmap="gray", extent=extent, vmin=0, vmax=1)
    for plane, color in ((overlay.start, START), (overlay.registered, ON_GREY)):
        for axis in axes:
            draw_contour(axis, plane.distance_mm, overlay.size_mm, color)
    for axis in axes:
        draw_plane_marks(axis, overlay.size_mm, overlay.registered.edges)
    axes[0].set_title(overlay.moment, fontsize=9)
    without_ticks(*axes)


def pose_figure(
    beats: BeatTrace | None, registrations: Sequence[RegistrationMark], span_s: tuple[float, float]
) -> Figure | None:
    """Draw the best pose of each beat: its error if the truth is known, and how much better it explains the
    beat than the pose in use; None without beats.
    """
    if beats is None:
        return None
    has_truth = beats.tre_mm is not None
    figure, axes = time_axes(4.4 if has_truth else 2.9, 2 if has_truth else 1)
    lower = axes[-1]
    if beats.tre_mm is not None:
        _by_use(axes[0], beats, beats.tre_mm)
        axes[0].axhline(GOOD_TRE_MM, color=GUIDE, lw=0.8, ls=":")
        axes[0].set_ylabel("mean TRE, mm")
        axes[0].margins(y=0.1)
        axes[0].set_ylim(bottom=0)
    _by_use(lower, beats, beats.log_likelihood_ratio)
    limit = lower.axhline(beats.limit, color=TRUTH, lw=0.8, ls="--", label="more than noise does")
    lower.set(ylabel="log-likelihood\nratio", xlabel="time, s", xlim=span_s)
    for axis in axes:
        for begin_s, end_s in beats.suspended_s:
            axis.axvspan(begin_s, end_s, color=SUSPENDED, lw=0, zorder=0)
        for mark in registrations:
            axis.axvline(mark.ready_s, color=GUIDE, lw=0.8, ls="-" if mark.usable else ":")
    handles: list[Artist] = [
        *(handle for handle in lower.get_legend_handles_labels()[0] if handle is not limit),
        limit,
        *_registration_handles(registrations),
    ]
    if len(beats.suspended_s) > 0:
        handles.append(Patch(color=SUSPENDED, label="pose suspended"))
    legend_below(figure, handles)
    return figure


def _registration_handles(registrations: Sequence[RegistrationMark]) -> list[Artist]:
    styles = ((True, "-", "registration in use from here"), (False, ":", "registration refused"))
    seen = {mark.usable for mark in registrations}
    return [
        Line2D([], [], color=GUIDE, lw=0.8, ls=style, label=label)
        for used, style, label in styles
        if used in seen
    ]


def _by_use(axis: Axes, beats: BeatTrace, values: FloatArray) -> None:
    times, in_use = beats.decided_s, beats.in_use
    for chosen, fill, color, label in (
        (in_use, ESTIMATE, ESTIMATE, "pose in use"),
        (~in_use, "none", START, "pose pending, no force"),
    ):
        if chosen.any():
            axis.plot(times[chosen], values[chosen], "o", ms=3, mfc=fill, color=color, label=label)


def breathing_figure(loop: BreathLoop) -> Figure:
    """Draw the hysteresis loop of the model with the measured beats, and the residuals beneath."""
    figure = Figure(figsize=(0.72 * WIDE_IN, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    handles: list[Artist] = []
    closed = np.append(np.arange(len(loop.course_mm)), 0)
    if loop.true_mm is not None:
        handles += upper.plot(
            loop.course_rho[closed], loop.true_mm[closed], color=TRUTH, lw=1.0, ls="--", label="ground truth"
        )
    for rising, color, marker, name in (
        (True, SERIES[0], "^", "inspiration"),
        (False, SERIES[1], "v", "expiration"),
    ):
        here = loop.course_inspiration[closed] == rising
        here[1:] |= here[:-1]
        course_mm = np.where(here, loop.course_mm[closed], np.nan)
        handles += upper.plot(loop.course_rho[closed], course_mm, color=color, lw=2.0, label=f"model, {name}")
        beats = loop.inspiration == rising
        for axis, values in ((upper, loop.displacement_mm), (lower, loop.residual_mm)):
            axis.errorbar(
                loop.rho[beats], values[beats], loop.sigma_mm[beats], fmt="none", ecolor=color, elinewidth=0.5
            )
            marks = axis.plot(
                loop.rho[beats], values[beats], marker, ms=4, color=color, label=f"heart beat, {name}"
            )
        handles += marks
    lower.axhline(0.0, color=TRUTH, lw=0.6)
    rms_mm, sigma_mm = (float(np.sqrt(np.mean(x**2))) for x in (loop.residual_mm, loop.sigma_mm))
    lower.set_title(f"RMS {rms_mm:.1f} mm, σ {sigma_mm:.1f} mm", fontsize=9, loc="right")
    upper.set_ylabel("displacement, mm")
    lower.set(ylabel="residual, mm", xlabel=f"surrogate ρ ({loop.surrogate}): 0 end-expiration, 1 usual top")
    open_frame(upper, lower)
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def phase_error_figure(ticks: TickTrace) -> Figure | None:
    """Draw phase error against time; None without ground truth."""
    if ticks.phase_error_percent is None:
        return None
    figure, (axis,) = time_axes(2.7)
    error = np.where(ticks.phase_valid, ticks.phase_error_percent, np.nan)
    (line,) = axis.plot(ticks.t_s, error, color=ESTIMATE, lw=0.8, label="estimated minus true phase")
    axis.axhline(0, color=TRUTH, lw=0.6)
    axis.set(ylabel="phase error, % of RR", xlabel="time, s")
    axis.margins(x=0)
    legend_below(figure, [line, *_shade_refused(axis, ticks.t_s, ticks.valid, "no force was given")])
    return figure


def force_figure(ticks: TickTrace) -> Figure:
    """Draw the size of the force and the distance to the surface against time."""
    t_s = ticks.t_s[THIN]
    figure, (upper, lower) = time_axes(4.2, 2)
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
    _shade_refused(upper, ticks.t_s, ticks.valid, "")
    shaded = _shade_refused(lower, ticks.t_s, ticks.valid, "no force was given")
    legend_below(figure, [*upper.get_legend_handles_labels()[0], *shaded])
    return figure


def supervisor_figure(trace: SupervisorTrace) -> Figure:
    """Draw states and hazards as bands over time, and the age of the pose."""
    rows = len(trace.bands)
    figure, (upper, lower) = time_axes(2.3 + 0.24 * rows, 2, height_ratios=(max(rows, 1), 5))
    for row, (_, color, active) in enumerate(trace.bands):
        edges = np.flatnonzero(np.diff(active, prepend=False, append=False))
        ends_s = np.append(trace.t_s, trace.t_s[-1])[edges]
        spans = [(begin, end - begin) for begin, end in zip(ends_s[::2], ends_s[1::2], strict=True)]
        upper.broken_barh(spans, (row - 0.4, 0.8), color=color, lw=0.6)
    upper.set_yticks(range(rows), [name for name, _, _ in trace.bands], fontsize=8)
    upper.set_ylim(rows - 0.4, -0.6)
    age_s = np.where(np.isfinite(trace.pose_age_s), trace.pose_age_s, np.nan)
    handles: list[Artist] = []
    handles += lower.plot(
        trace.t_s[THIN], age_s[THIN], color=ESTIMATE, lw=0.8, label="since a beat confirmed the pose"
    )
    handles += lower.plot(
        trace.t_s[THIN],
        trace.age_limit_s[THIN],
        color=TRUTH,
        lw=0.8,
        ls="--",
        label="pose withheld from here on",
    )
    top_s = 1.6 * float(np.nanmax(trace.age_limit_s, initial=1.0))
    lower.set(ylabel="pose age, s", xlabel="time, s", ylim=(0, top_s))
    lower.set_xlim(float(trace.t_s[0]), float(trace.t_s[-1]))
    named_s = -np.inf
    for begin_s, end_s, rule in trace.withheld:
        lower.axvspan(begin_s, end_s, color=SUSPENDED, lw=0, zorder=0)
        if begin_s - named_s > RULE_WIDTH * (trace.t_s[-1] - trace.t_s[0]):
            lower.annotate(
                rule, (begin_s, 0.97 * top_s), xytext=(3, 0), textcoords="offset points", va="top", fontsize=8
            )
            named_s = begin_s
    if trace.withheld:
        handles.append(Patch(color=SUSPENDED, label="pose withheld"))
    legend_below(figure, handles)
    return figure


def distance_histogram(ticks: TickTrace) -> Figure:
    """Draw the number of ticks at each distance from the surface while a force was given."""
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
    axis.set(xlabel="distance from the surface, mm (inside > 0)", ylabel="ticks")
    axis.legend(loc="upper left", fontsize=9, frameon=False)
    return figure


def ecg_figure(strip: EcgStrip) -> Figure:
    """Draw the ECG or trigger with detected R peaks, and the phase derived from them."""
    figure, (upper, lower) = time_axes(3.8, 2)
    if strip.ecg is None:
        upper.vlines(strip.ecg_t_s, 0.0, 1.0, color=TRUTH, lw=0.8)
        upper.set_yticks([])
        height = np.zeros(len(strip.r_peaks_s))
    else:
        upper.plot(strip.ecg_t_s, strip.ecg, color=TRUTH, lw=0.8)
        has_samples = len(strip.ecg_t_s) > 0
        height = (
            np.interp(strip.r_peaks_s, strip.ecg_t_s, strip.ecg) if has_samples else 0.0 * strip.r_peaks_s
        )
    handles: list[Artist] = list(
        upper.plot(
            strip.r_peaks_s, height, "o", ms=5, mfc="none", color=ESTIMATE, label="R peak, as detected"
        )
    )
    upper.set_ylabel(strip.label)
    lower.plot(strip.t_s, strip.phase, ".", ms=1, color=ESTIMATE)
    handles.append(Line2D([], [], color=ESTIMATE, label="phase estimated"))
    if strip.true_phase is not None:
        lower.plot(strip.t_s, strip.true_phase, ".", ms=0.6, color=TRUTH)
        handles.append(Line2D([], [], color=TRUTH, label="phase by the ground truth"))
    lower.set(
        ylabel="phase φ", xlabel="time, s", ylim=(0, 1), xlim=(float(strip.t_s[0]), float(strip.t_s[-1]))
    )
    handles += _shade_refused(lower, strip.t_s, strip.phase_valid, "phase could not be used")
    legend_below(figure, handles)
    return figure


def _shade_refused(axis: Axes, t_s: FloatArray, valid: BoolArray, meaning: str) -> list[Artist]:
    """Shade times at which `valid` (n,) is False, and return a legend entry if there are any."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], valid, [True]]).astype(np.int8)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        axis.axvspan(t_s[begin], t_s[min(end, len(t_s) - 1)], color=REFUSED, lw=0, zorder=0)
    return [Patch(color=REFUSED, label=meaning)] if len(edges) else []
