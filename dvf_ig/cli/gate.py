"""`dvf-ig gate`: causal R peaks and phase of an ECG or a trigger, and the clock of breathing."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from .shell import EcgLeadOption, EcgRateOption, JsonFlag, command, emit, out_file, progress, warn, wrote

if TYPE_CHECKING:
    from dvf_ig.cardiac import PhaseTracking
    from dvf_ig.core import FloatArray, Signal, TriggerTimes

VALIDITY_RATE_HZ = 100.0


def gate(
    ecg: Annotated[
        str | None,
        Argument(
            help="wfdb:RECORD, edf:FILE, csv:FILE or plus:SEQUENCE[#FIELD] (an ending .hea, .dat, .edf, "
            ".bdf, .csv, .tsv, .ecg, .mha or .nrrd is enough), or trigger:FILE.",
            metavar="ECG",
        ),
    ] = None,
    rate: EcgRateOption = None,
    lead: EcgLeadOption = None,
    phase_at: Annotated[
        float | None, Option(help="Also give phase at this rate (Hz).", min=0.1, max=10_000.0)
    ] = None,
    delay_s: Annotated[
        float | None, Option(help="trigger:FILE only: time from R to the trigger (s).")
    ] = None,
    respiration: Annotated[
        str | None,
        Option(
            help="Breathing: csv:FILE#CHANNEL or wfdb:RECORD#CHANNEL (#CHANNEL if several may be meant), or "
            "marker:FILE; with or without an ECG."
        ),
    ] = None,
    output: Annotated[Path | None, out_file("Write the result (JSON), and a picture next to it.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Detect R peaks causally and report where the heart's phase is valid; follow breathing likewise."""
    with command():
        from dvf_ig.io import files_together, provenance_fields, require_outputs, write_json
        from dvf_ig.io.writing.atomic import write_bytes

        if ecg is None and respiration is None:
            raise typer.BadParameter("give an ECG, or --respiration KIND:FILE")
        pictures = []
        if output is not None:
            pictures = [output.with_suffix(".png")] if ecg is not None else []
            pictures += [output.with_suffix(".breathing.png")] if respiration is not None else []
            require_outputs(output, *pictures)
        result: dict[str, Any] = {}
        rows: list[tuple[str, str]] = []
        drawn: list[bytes] = []
        if ecg is not None:
            signal, tracking = _track(ecg, rate, lead, phase_at or VALIDITY_RATE_HZ, delay_s)
            result |= _result(signal, tracking, with_phase=phase_at is not None)
            rows += _rows(result)
            drawn += [_picture(ecg, signal, tracking)] if output is not None else []
        if respiration is not None:
            breathing, picture = followed_breathing(respiration, rate, draw=output is not None)
            result["respiration"] = breathing
            rows += breathing_rows(breathing)
            drawn += [] if picture is None else [picture]
        if output is not None:
            with files_together(output.parent, (output.name, *(p.name for p in pictures))) as new:
                write_json(new / output.name, {**result, **provenance_fields()})
                for path, png in zip(pictures, drawn, strict=True):
                    write_bytes(new / path.name, png)
            for path in (output, *pictures):
                wrote(path)
        emit(result, rows, as_json=as_json)


def _track(
    spec: str,
    ecg_rate_hz: float | None,
    lead: str | None,
    rate_hz: float,
    delay_s: float | None,
) -> "tuple[Signal | None, PhaseTracking]":
    import numpy as np

    from dvf_ig.cardiac import track_phase
    from dvf_ig.core import Signal
    from dvf_ig.io import read_beat_source

    source = read_beat_source(spec, rate_hz=ecg_rate_hz, delay_s=delay_s, lead=lead)
    if isinstance(source, Signal):
        duration_s = len(source) / source.rate_hz
        t_s = source.start_s + np.arange(max(1, int(duration_s * rate_hz))) / rate_hz
        with progress("heart beats") as report:
            return source, track_phase(source, t_s, progress=report)
    tracking = track_phase(source, _trigger_times(source, rate_hz))
    doubles = len(tracking.lead_changes) // 2
    if doubles:
        warn(
            f"{doubles} of {len(source)} pulses come too soon after another to be a beat; the phase is not "
            "valid after them: record one edge of each pulse"
        )
    return None, tracking


def _trigger_times(source: "TriggerTimes", rate_hz: float) -> "FloatArray":
    import numpy as np

    count = max(1, int((source.t_s[-1] - source.start_s) * rate_hz) + 1)
    return np.asarray(source.start_s + np.arange(count) / rate_hz)


def _result(signal: "Signal | None", tracking: "PhaseTracking", *, with_phase: bool) -> dict[str, Any]:
    from dvf_ig.cardiac import state_segments, summarise_gating

    summary = summarise_gating(tracking.peaks, tracking.track, tracking.lead_changes)
    result: dict[str, Any] = {
        "beats_s": [peak.t_s for peak in tracking.peaks],
        "detected_at_s": [peak.detected_at_s for peak in tracking.peaks],
        "quality": [peak.quality for peak in tracking.peaks],
        "rate_bpm": summary.rate_bpm,
        "valid_share": summary.valid_share,
        "invalid_segments_s": summary.invalid_segments_s.tolist(),
        "invalid_reasons": list(summary.invalid_reasons),
        "leads": [] if signal is None else list(signal.leads),
        "left_out": [] if signal is None else list(signal.left_out),
        "state_segments": [
            {"start_s": start, "stop_s": stop, "state": state.name}
            for start, stop, state in state_segments(tracking.track)
        ],
    }
    rates = _breath_rates(signal, tracking)
    if rates is not None:
        result["breathing_by_ecg"] = dict(zip(("low", "median", "high"), rates, strict=True))
    if with_phase:
        track = tracking.track
        result["phase"] = {
            "t_s": track.t_s.tolist(),
            "phi": track.phi.tolist(),
            "valid": track.valid.tolist(),
        }
    return result


def _breath_rates(signal: "Signal | None", tracking: "PhaseTracking") -> list[float] | None:
    """Compute quartiles of the breaths a minute that the ECG shows; None without, or if it is too short."""
    import numpy as np

    from dvf_ig.cardiac.respiration import beat_values, breath_rates

    if signal is None or not tracking.peaks:
        return None
    rates = breath_rates(*beat_values(signal, tracking.peaks))
    return np.percentile(rates, (25.0, 50.0, 75.0)).tolist() if len(rates) else None


def _picture(spec: str, signal: "Signal | None", tracking: "PhaseTracking") -> bytes:
    import numpy as np

    from dvf_ig.report import gate_png

    name = Path(spec.rpartition(":")[2]).name
    return gate_png(name, signal, np.array([peak.t_s for peak in tracking.peaks]), tracking.track)


def _rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    segments = result["invalid_segments_s"]
    shown = "; ".join(
        f"{start:.1f}–{stop:.1f} s ({why})"
        for (start, stop), why in zip(segments[:8], result["invalid_reasons"], strict=False)
    )
    more = f" and {len(segments) - 8} more" if len(segments) > 8 else ""
    delays = sorted(
        detected - peak for detected, peak in zip(result["detected_at_s"], result["beats_s"], strict=True)
    )
    left = f"; left out: {', '.join(result['left_out'])}" if result["left_out"] else ""
    return [
        ("leads", f"{', '.join(result['leads']) or 'trigger'}{left}"),
        ("beats", f"{len(result['beats_s'])}"),
        ("rate", f"{result['rate_bpm']:.1f} /min"),
        ("detection delay", f"{1000 * delays[len(delays) // 2]:.0f} ms (median)"),
        ("phase valid", f"{100 * result['valid_share']:.1f} % of the time"),
        *_breath_rate_rows(result.get("breathing_by_ecg")),
        ("not valid", f"{shown}{more}" if segments else "never"),
        ("states", ", ".join(_reasons(result["state_segments"])) or "–"),
    ]


def _breath_rate_rows(rates: dict[str, float] | None) -> list[tuple[str, str]]:
    if rates is None:
        return []
    text = f"{rates['median']:.0f} (half of all windows: {rates['low']:.0f} to {rates['high']:.0f})"
    return [("breaths a minute in the ECG", text)]


def _reasons(segments: list[dict[str, Any]]) -> list[str]:
    """List the seconds in each state other than LOCKED, the longest first."""
    seconds: dict[str, float] = {}
    for segment in segments:
        if segment["state"] != "LOCKED":
            length_s = segment["stop_s"] - segment["start_s"]
            seconds[segment["state"]] = seconds.get(segment["state"], 0.0) + length_s
    return [f"{name} {s:.0f} s" for name, s in sorted(seconds.items(), key=lambda item: -item[1])]


READ_HZ = 10.0


def followed_breathing(
    spec: str, rate_hz: float | None, *, draw: bool
) -> tuple[dict[str, Any], bytes | None]:
    """Follow a recording of breathing causally; also draw it."""
    import numpy as np

    from dvf_ig.cardiac.respiration import BreathEvent, BreathState, track_breathing
    from dvf_ig.io.respiration import read_respiration
    from dvf_ig.report import breathing_png

    recorded = read_respiration(spec, rate_hz)
    t_s = np.arange(recorded.t_s[0] + 1.0 / READ_HZ, recorded.t_s[-1], 1.0 / READ_HZ)
    with progress("breaths") as report:
        track = track_breathing(recorded, t_s, progress=report)
    shares = {state.name: float((track.state == state).mean()) for state in BreathState}
    begins = np.flatnonzero((track.event[1:] != track.event[:-1]) & (track.event[1:] > 0)) + 1
    rate = track.rate_per_min(float(t_s[0]), float(t_s[-1])) if len(t_s) else float("nan")
    result = {
        "name": recorded.name,
        "breaths_s": track.onsets_s.tolist(),
        "rate_per_min": rate if np.isfinite(rate) else None,
        "state_share": shares,
        "events": [
            {"t_s": float(t_s[i]), "event": BreathEvent(int(track.event[i])).name} for i in begins.tolist()
        ],
    }
    name = Path(spec.partition(":")[2]).name
    return result, breathing_png(name, track) if draw else None


def breathing_rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Describe breathing as a table."""
    rate, events = result["rate_per_min"], result["events"]
    shown = ", ".join(f"{e['event'].lower().replace('_', ' ')} at {e['t_s']:.0f} s" for e in events[:6])
    more = f" and {len(events) - 6} more" if len(events) > 6 else ""
    return [
        ("breathing", f"{result['name']}, {len(result['breaths_s'])} breaths"),
        ("breaths a minute", "too few, or irregular" if rate is None else f"{rate:.1f}"),
        ("breathing locked", f"{100 * result['state_share']['LOCKED']:.1f} % of the time"),
        ("breathing events", f"{shown}{more}" if events else "none"),
    ]
