"""The report's pictures, each one figure. Blue is estimated, orange is the start, black is the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import FloatArray, PhaseState, Rigid
from dvf_ig.guidance import Evaluator, Sigmoid
from dvf_ig.registration import target_errors_mm

from .pose_summary import suspensions
from .registration_monitor import SUSPEND_LOG_RATIO
from .result import true_contact, true_phases

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .engine import Replay
    from .pose_history import Attempt

ESTIMATE, START, TRUTH, REFUSED, DOUBT = "#1f6fb4", "#e07b00", "#222222", "#d9d9d9", "#f6d5d2"
WIDE = (10.5, 2.6)


def overlay(replay: Replay) -> Figure | None:
    """Ultrasound views with the model's surface before and after registration, the MR plane beneath.

    None where no registration could look at any frame.
    """
    attempt = next((a for a in reversed(replay.attempts) if a.usable), None)
    attempt = attempt or next((a for a in reversed(replay.attempts) if a.result), None)
    images = replay.scenario.ultrasound.images
    if attempt is None or attempt.result is None or images is None:
        return None
    chosen = attempt.frames.used[np.linspace(0, len(attempt.frames.used) - 1, 6).astype(int)[1:5]]
    figure = Figure(figsize=(10.5, 5.6), layout="constrained")
    axes = figure.subplots(2, len(chosen))
    for column, frame in enumerate(chosen):
        _overlay_column(
            replay, attempt, attempt.result.target_from_source, images, int(frame), axes[:, column]
        )
    axes[0, 0].set_ylabel("ultrasound")
    axes[1, 0].set_ylabel("model at the same place")
    handles = [
        axes[0, 0].plot([], [], color=color, lw=1.6, label=label)[0]
        for color, label in ((START, "surface at the start pose"), (ESTIMATE, "surface after registration"))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _overlay_column(
    replay: Replay,
    attempt: Attempt,
    pose: Rigid,
    images: NDArray[np.uint8],
    frame: int,
    axes: NDArray[np.object_],
) -> None:
    sight, step = attempt.frames, 2
    image = images[sight.first + frame]
    rows, columns = image.shape
    row, col = np.mgrid[:rows:step, :columns:step]
    pixels = np.column_stack([col.ravel(), row.ravel()]).astype(np.float64)
    probe = replay.calibrations.probe.probe_from_image.apply_pixels(pixels).xyz_mm
    tracker = probe @ sight.rotations[frame].T + sight.translations_mm[frame]
    phase = float(sight.model_phase[frame])
    extent = (0, columns, rows, 0)
    axes[0].imshow(image, cmap="gray", extent=extent, vmin=0, vmax=255)
    axes[1].imshow(_model_plane(replay, pose, tracker, phase).reshape(row.shape), cmap="gray", extent=extent)
    for transform, color in ((replay.start, START), (pose, ESTIMATE)):
        distance = _distance(replay, transform, tracker, phase).reshape(row.shape)
        for axis in axes:
            if np.nanmin(distance) < 0 < np.nanmax(distance):
                axis.contour(col, row, distance, levels=[0.0], colors=[color], linewidths=1.2)
    axes[0].set_title(f"{sight.event_s[frame]:.1f} s, {100 * phase:.0f} % of the cycle", fontsize=9)
    for axis in axes:
        axis.set(xticks=[], yticks=[])


def _distance(replay: Replay, pose: Rigid, tracker_mm: FloatArray, phase: float) -> FloatArray:
    evaluator = Evaluator(replay.heart.model, Sigmoid(), blend="distance")
    return evaluator.force_through(pose, tracker_mm, phase).distance_mm


def _model_plane(replay: Replay, pose: Rigid, tracker_mm: FloatArray, phase: float) -> FloatArray:
    channels = replay.heart.fine
    nearest = int(channels.nearest_phase(np.array([phase]))[0])
    index = channels.grid.to_index(pose.apply_array(tracker_mm))
    values = channels.values[nearest, ..., 0]
    return np.asarray(ndimage.map_coordinates(values, index.T, order=1, cval=float(values.min())))


def pose_over_time(replay: Replay) -> Figure | None:
    """Every beat's answer about the pose, and its error where the truth is known; None without beats."""
    beats, truth, t_s = replay.history.beats, replay.scenario.truth, replay.tracking.track.t_s
    if not beats:
        return None
    figure = Figure(figsize=(WIDE[0], 3.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    times = np.array([beat.decided_s for beat in beats])
    guided = np.array([beat.in_use for beat in beats])
    log_ratio = np.array([beat.measurement.log_likelihood_ratio for beat in beats])
    if truth is not None:
        targets = truth.targets.points
        error = np.array(
            [
                target_errors_mm(b.measurement.pose, truth.mr_from_tracker_at(b.end_s), targets).mean()
                for b in beats
            ]
        )
        _by_guidance(upper, times, error, guided)
        upper.axhline(2.0, color=TRUTH, lw=0.8, ls=":")
    upper.set_ylabel("mean TRE, mm")
    upper.margins(y=0.1)
    upper.set_ylim(bottom=0)
    _by_guidance(lower, times, log_ratio, guided)
    lower.axhline(SUSPEND_LOG_RATIO, color=TRUTH, lw=0.8, ls=":")
    lower.set(ylabel="log-likelihood ratio", xlabel="time, s", xlim=(float(t_s[0]), float(t_s[-1])))
    for axis in (upper, lower):
        for begin_s, end_s in suspensions(replay.history.updates, float(t_s[-1])):
            axis.axvspan(begin_s, end_s, color=DOUBT, lw=0, zorder=0)
        for attempt in replay.attempts:
            axis.axvline(attempt.ready_s, color=TRUTH, lw=0.6, ls="-" if attempt.usable else ":")
    figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _by_guidance(axis: Axes, times: FloatArray, values: FloatArray, guided: NDArray[np.bool_]) -> None:
    axis.plot(times[guided], values[guided], "o", ms=3, color=ESTIMATE, label="pose that guides")
    axis.plot(
        times[~guided], values[~guided], "o", ms=3, mfc="none", color=START, label="pose on trial, no force"
    )


def phase_error(replay: Replay) -> Figure | None:
    """Phase error against time; None without truth."""
    if replay.scenario.truth is None:
        return None
    track = replay.tracking.track
    figure = Figure(figsize=WIDE, layout="constrained")
    axis = figure.subplots()
    error = 100 * ((track.phi - true_phases(replay)[0] + 0.5) % 1.0 - 0.5)
    axis.plot(track.t_s, np.where(track.valid, error, np.nan), color=ESTIMATE, lw=0.8)
    axis.axhline(0, color=TRUTH, lw=0.6)
    axis.set(ylabel="phase error, % RR", xlabel="time, s")
    _shade_refused(axis, track.t_s, replay.valid)
    return figure


def force_trace(replay: Replay) -> Figure:
    """Force magnitude and distance to the surface against time."""
    t_s, thin = replay.tracking.track.t_s, slice(None, None, 5)
    figure = Figure(figsize=(WIDE[0], 3.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    magnitude = np.linalg.norm(replay.samples.force_n, axis=1)
    if replay.scenario.truth is not None:
        distance, force = true_contact(replay)
        upper.plot(t_s[thin], np.linalg.norm(force, axis=1)[thin], color=TRUTH, lw=0.8, label="truth")
        lower.plot(t_s[thin], distance[thin], color=TRUTH, lw=0.8)
    upper.plot(t_s[thin], magnitude[thin], color=ESTIMATE, lw=0.8, label="given")
    lower.plot(t_s[thin], replay.samples.distance_mm[thin], color=ESTIMATE, lw=0.8)
    upper.set(ylabel="|force|, N", ylim=(0, 0.65))
    upper.legend(loc="upper left", fontsize=8, frameon=False, ncols=2)
    lower.set(ylabel="distance, mm\n(inside > 0)", xlabel="time, s", ylim=(-15, 5))
    lower.axhline(0, color=TRUTH, lw=0.6, ls=":")
    for axis in (upper, lower):
        _shade_refused(axis, t_s, replay.valid)
    return figure


def distance_histogram(replay: Replay) -> Figure:
    """How long the tip spent at each distance from the surface (Ren 2008, Fig. 14)."""
    figure = Figure(figsize=(5.2, 2.8), layout="constrained")
    axis = figure.subplots()
    bins = np.linspace(-10, 5, 61).tolist()
    seen = replay.samples.distance_mm[replay.valid]
    axis.hist(seen, bins=bins, color=ESTIMATE, alpha=0.7, label="estimated")
    if replay.scenario.truth is not None:
        distance, _ = true_contact(replay)
        axis.hist(distance[replay.valid], bins=bins, histtype="step", color=TRUTH, lw=1.2, label="truth")
    axis.axvline(0, color=TRUTH, lw=0.8, ls=":")
    axis.set(xlabel="distance from the surface, mm (inside > 0)", ylabel="ticks")
    axis.legend(fontsize=8, frameon=False)
    return figure


def ecg_strip(replay: Replay, seconds: float = 12.0) -> Figure:
    """The ECG's first lead with detected R peaks, and the phase kept from them, mid-record."""
    ecg, track = replay.scenario.ecg, replay.tracking.track
    middle = float(track.t_s[len(track.t_s) // 2])
    begin = max(float(track.t_s[0]), middle - seconds / 2)
    figure = Figure(figsize=(WIDE[0], 3.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    shown = (ecg.t_s >= begin) & (ecg.t_s < begin + seconds)
    upper.plot(ecg.t_s[shown], ecg.samples[shown, 0], color=TRUTH, lw=0.8)
    peaks = np.array([p.t_s for p in replay.tracking.peaks if begin <= p.t_s < begin + seconds])
    upper.plot(
        peaks, np.interp(peaks, ecg.t_s, ecg.samples[:, 0]), "o", ms=5, mfc="none", color=ESTIMATE, label="R"
    )
    upper.set_ylabel(f"{ecg.leads[0]}, {ecg.unit}")
    window = (track.t_s >= begin) & (track.t_s < begin + seconds)
    lower.plot(track.t_s[window], track.phi[window], ".", ms=1, color=ESTIMATE)
    if replay.scenario.truth is not None:
        lower.plot(track.t_s[window], true_phases(replay)[0][window], ".", ms=0.6, color=TRUTH)
    lower.set(ylabel="phase φ", xlabel="time, s", ylim=(0, 1), xlim=(begin, begin + seconds))
    _shade_refused(lower, track.t_s[window], track.state[window] == int(PhaseState.LOCKED))
    return figure


def _shade_refused(axis: Axes, t_s: FloatArray, valid: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> None:
    edges = np.flatnonzero(np.diff(np.concatenate([[True], valid, [True]]).astype(np.int8)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        axis.axvspan(t_s[begin], t_s[min(end, len(t_s) - 1)], color=REFUSED, lw=0, zorder=0)
