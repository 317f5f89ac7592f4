"""Draw a gated recording: the RR tachogram with the clock's states, and rhythm strips; and breathing.

What takes long to load (matplotlib, scipy.signal by way of dvf_ig.cardiac) is loaded when a picture is drawn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dvf_ig.core import FloatArray, PhaseState, PhaseTrack, Signal

from .style import ESTIMATE, TRUTH, png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dvf_ig.cardiac.respiration import BreathTrack

STRIPS, STRIP_S = 6, 10.0
"""Number of strips and seconds per strip, as on a printed strip (25 mm/s)."""
LONGEST_RR_MS = 2500.0
MINUTES_FROM_S = 180.0

_SHADE = {
    PhaseState.INIT: "#d7e6f5",
    PhaseState.SUSPECT: "#fbe3a2",
    PhaseState.LOST: "#b8bcc4",
    PhaseState.IRREGULAR: "#f3bcc8",
}
_MEANING = {
    PhaseState.INIT: "INIT, or LOST with R peaks again: learning",
    PhaseState.LOCKED: "LOCKED: phase may be used",
    PhaseState.SUSPECT: "SUSPECT: early or uncertain beat",
    PhaseState.LOST: "LOST: no R peak",
    PhaseState.IRREGULAR: "IRREGULAR: not predictable",
}
_TRACE, _LOCKED, _UNUSED, _PAPER = TRUTH, ESTIMATE, "#b0502a", "#f2c9c9"


def gate_png(name: str, signal: Signal | None, r_peaks_s: FloatArray, track: PhaseTrack) -> bytes:
    """Draw the picture as a PNG.

    Args:
        name: title.
        signal: the ECG; None if the beats came from a trigger.
        r_peaks_s: (k,) R peaks on the track's clock.
        track: phase and state over the recording.
    """
    from matplotlib.figure import Figure

    chosen = choose_strips(track)
    figure = Figure(figsize=(12.0, 3.0 + 1.45 * len(chosen)), layout="constrained")
    axes = figure.subplots(
        1 + len(chosen), 1, squeeze=False, gridspec_kw={"height_ratios": [2.1, *([1.0] * len(chosen))]}
    )[:, 0]
    peaks = np.sort(r_peaks_s)
    _draw_tachogram(axes[0], peaks, track, chosen)
    valid = 100 * float(track.valid.mean())
    axes[0].set_title(f"{name}: {len(peaks)} beats, phase valid {valid:.1f} % of the time", fontsize=11)
    band = _band(signal)
    for letter, start_s, axis in zip("ABCDEFGHIJ", chosen, axes[1:], strict=False):
        _draw_strip(axis, letter, start_s, signal, peaks, track, band)
    axes[-1].set_xlabel("time, s (0.2 s per division)")
    _draw_legend(figure, track, peaks)
    return png_bytes(figure)


def choose_strips(track: PhaseTrack) -> list[float]:
    """Choose the starts of the strips, in order of time: a good one, the worst of each state, then the rest.

    Rows are taken from a fixed raster of STRIP_S, so that none overlap.
    """
    begin, end = float(track.t_s[0]), float(track.t_s[-1])
    starts = np.arange(begin, max(end - STRIP_S, begin) + 1e-9, STRIP_S)
    row = np.clip(((track.t_s - begin) / STRIP_S).astype(np.int64), 0, len(starts) - 1)
    counts = np.bincount(row, minlength=len(starts))
    share = {
        state: np.bincount(row, weights=track.state == int(state), minlength=len(starts)) / counts
        for state in PhaseState
    }
    good = share[PhaseState.LOCKED]
    # prefers an equally good strip after the first third
    chosen = [int(np.argmax(good + 1e-3 * (np.arange(len(starts)) >= len(starts) // 3)))]
    rows = range(len(starts))
    for state in (PhaseState.IRREGULAR, PhaseState.LOST, PhaseState.SUSPECT):
        left = [k for k in rows if min(abs(k - c) for c in chosen) > 1 and share[state][k] > 0]
        if left:
            chosen.append(max(left, key=lambda k: (share[state][k], -k)))
    for part in np.array_split(np.arange(len(starts)), STRIPS):
        left = [k for k in part.tolist() if min(abs(k - c) for c in chosen) > 1]
        if left and len(chosen) < STRIPS:
            chosen.append(max(left, key=lambda k: (round(1.0 - float(good[k]), 3), -k)))
    return [float(starts[k]) for k in sorted(chosen)]


def _draw_tachogram(axis: Axes, peaks: FloatArray, track: PhaseTrack, chosen: list[float]) -> None:
    long = track.t_s[-1] - track.t_s[0] > MINUTES_FROM_S
    unit = 60.0 if long else 1.0
    _shade(axis, track, peaks, (float(track.t_s[0]), float(track.t_s[-1])), unit)
    rr_ms = 1000 * np.diff(peaks)
    at = np.clip(np.searchsorted(track.t_s, peaks[1:]), 0, len(track.t_s) - 1)
    locked = track.valid[at]
    for which, color in ((locked, _LOCKED), (~locked, _UNUSED)):
        axis.plot(peaks[1:][which] / unit, rr_ms[which], ".", ms=2.2 if long else 4, color=color)
    top = min(LONGEST_RR_MS, 1.12 * float(np.percentile(rr_ms, 99.5))) if len(rr_ms) else LONGEST_RR_MS
    bottom = 0.85 * float(np.percentile(rr_ms, 0.5)) if len(rr_ms) else 0.0
    axis.set(
        xlim=(track.t_s[0] / unit, track.t_s[-1] / unit),
        ylim=(bottom, top + 0.1 * (top - bottom)),
        ylabel="RR interval, ms",
        xlabel="time, min" if long else "time, s",
    )
    for letter, start_s in zip("ABCDEFGHIJ", chosen, strict=False):
        middle = (start_s + 0.5 * STRIP_S) / unit
        axis.annotate(
            letter,
            (middle, 0.985),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=9,
            weight="bold",
        )
        axis.axvspan(start_s / unit, (start_s + STRIP_S) / unit, color=_LOCKED, alpha=0.1, lw=0)


def _draw_strip(
    axis: Axes,
    letter: str,
    start_s: float,
    signal: Signal | None,
    peaks: FloatArray,
    track: PhaseTrack,
    band: tuple[float, float],
) -> None:
    stop_s = start_s + STRIP_S
    axis.set_xticks(np.arange(np.ceil(start_s), stop_s + 1e-9, 1.0))
    axis.set_xticks(np.arange(np.ceil(start_s * 5) / 5, stop_s, 0.2), minor=True)
    axis.grid(which="both", axis="x", color=_PAPER, lw=0.5)
    _shade(axis, track, peaks, (start_s, stop_s), 1.0)
    here = peaks[(peaks >= start_s) & (peaks < stop_s)]
    low, high = band
    if signal is not None:
        axis.set_yticks(np.arange(np.ceil(low * 2) / 2, high, 0.5), minor=True)
        axis.grid(which="minor", axis="y", color=_PAPER, lw=0.5)
        shown = (signal.t_s >= start_s) & (signal.t_s < stop_s)
        value = signal.samples[shown, 0]
        finite = np.isfinite(value)
        middle = float(np.median(value[finite])) if finite.any() else 0.0
        axis.plot(signal.t_s[shown], np.clip(value - middle, low, high), color=_TRACE, lw=0.8)
    axis.plot(here, np.full(len(here), high - 0.04 * (high - low)), "v", ms=4.5, color=_LOCKED, clip_on=False)
    locked = track.valid[(track.t_s >= start_s) & (track.t_s < stop_s)]
    rate = f"{60 / np.median(np.diff(here)):.0f}/min" if len(here) > 2 else "no rate"
    axis.text(0.004, 0.05, f"{rate}, valid {100 * locked.mean():.0f} %", transform=axis.transAxes, fontsize=8)
    axis.set(xlim=(start_s, stop_s), ylim=(low, high))
    unit = signal.unit if signal is not None else ""
    lead = signal.leads[0] if signal is not None else "trigger"
    axis.set_ylabel(f"{letter}\n{lead}, {unit}".rstrip(", "), fontsize=8)
    axis.tick_params(labelsize=8)


def _band(signal: Signal | None) -> tuple[float, float]:
    """Return the range of amplitudes about the median that every strip shows."""
    if signal is None:
        return 0.0, 1.0
    value = signal.samples[:, 0]
    value = value[np.isfinite(value)]
    if len(value) == 0 or np.ptp(value) == 0:
        return -1.0, 1.0
    low, high = np.percentile(value - np.median(value), (0.1, 99.9))
    room = 0.3 * (high - low)
    return float(low - room), float(high + room)


def shown_segments(track: PhaseTrack, peaks_s: FloatArray) -> list[tuple[float, float, PhaseState]]:
    """List segments of one state; LOST ends with the next R peak, from which the clock learns again."""
    from dvf_ig.cardiac import state_segments

    shown: list[tuple[float, float, PhaseState]] = []
    for begin, end, state in state_segments(track):
        again = peaks_s[(peaks_s > begin) & (peaks_s < end)]
        if state is PhaseState.LOST and len(again):
            first = float(again[0])
            shown += [(begin, first, state), (first, end, PhaseState.INIT)]
        else:
            shown.append((begin, end, state))
    return shown


def _shade(
    axis: Axes, track: PhaseTrack, peaks: FloatArray, span_s: tuple[float, float], unit: float
) -> None:
    start_s, stop_s = span_s
    for begin, end, state in shown_segments(track, peaks):
        if state in _SHADE and end > start_s and begin < stop_s:
            axis.axvspan(
                max(begin, start_s) / unit, min(end, stop_s) / unit, color=_SHADE[state], lw=0, zorder=0
            )


def _draw_legend(figure: Figure, track: PhaseTrack, peaks: FloatArray) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    seen = {state for _, _, state in shown_segments(track, peaks)}
    handles: list[object] = [
        Line2D([], [], marker="v", ls="", ms=5, color=_LOCKED, label="R peak, as detected"),
        Line2D([], [], marker=".", ls="", ms=6, color=_LOCKED, label=_MEANING[PhaseState.LOCKED]),
        Line2D([], [], marker=".", ls="", ms=6, color=_UNUSED, label="RR while phase was refused"),
    ]
    handles += [Patch(color=_SHADE[s], label=_MEANING[s]) for s in PhaseState if s in _SHADE and s in seen]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=(len(handles) + 1) // 2,
        fontsize=8,
        frameon=False,
        columnspacing=1.2,
    )


def breathing_png(name: str, track: BreathTrack) -> bytes:
    """Draw ρ with the states of the breathing clock as a PNG."""
    from matplotlib.figure import Figure

    from dvf_ig.cardiac.respiration import BreathState

    shades = {BreathState.INIT: PhaseState.INIT, BreathState.IRREGULAR: PhaseState.IRREGULAR}
    figure = Figure(figsize=(12.0, 3.2), layout="constrained")
    axes = figure.subplots()
    for state in (BreathState.INIT, BreathState.IRREGULAR, BreathState.LOST):
        colour = _SHADE[shades.get(state, PhaseState.LOST)]
        shown = track.state == state
        axes.fill_between(track.t_s, 0, 1, where=shown, transform=axes.get_xaxis_transform(), color=colour)
    axes.plot(track.t_s, track.rho, color=_LOCKED, linewidth=0.9)
    axes.plot(track.onsets_s, np.zeros(len(track.onsets_s)), "|", color=_UNUSED, markersize=9)
    rate = track.rate_per_min(float(track.t_s[0]), float(track.t_s[-1]))
    locked = 100 * float((track.state == BreathState.LOCKED).mean())
    axes.set_title(f"{name}: {rate:.1f} breaths/min, locked {locked:.1f} % of the time", fontsize=11)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("ρ: 0 end-expiration, 1 usual top")
    return png_bytes(figure)
