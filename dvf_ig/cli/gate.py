"""`dvf-ig gate`: R peaks and phase of an ECG, as they would have been known live."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .shell import JsonFlag, command, emit, wrote

if TYPE_CHECKING:
    from dvf_ig.cardiac import PhaseTracking
    from dvf_ig.core import Signal

VALIDITY_RATE_HZ = 100.0


def gate(
    ecg: Annotated[str, typer.Argument(help="wfdb:RECORD, edf:FILE or csv:FILE.", metavar="ECG")],
    phase_at: Annotated[
        float | None,
        typer.Option("--phase-at", help="Also give phase at this rate (Hz).", min=0.1, max=10_000.0),
    ] = None,
    predictor: Annotated[str, typer.Option("--predictor", help="RR predictor: ar8, ewma or last.")] = "ar8",
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the result (JSON).")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Find R peaks causally and say where the heart's phase could be trusted."""
    with command():
        from dvf_ig.io import read_ecg, write_json

        signal = read_ecg(ecg)
        rate_hz = phase_at or VALIDITY_RATE_HZ
        tracking = _track(signal, rate_hz, predictor)
        result = _result(tracking, with_phase=phase_at is not None)
        if output is not None:
            write_json(output, result)
            wrote(output)
        emit(result, _rows(result), as_json=as_json)


def _track(signal: "Signal", rate_hz: float, predictor: str) -> "PhaseTracking":
    import numpy as np

    from dvf_ig.cardiac import PREDICTORS, PhaseClockOptions, track_phase
    from dvf_ig.core import InvalidInputError

    if predictor not in PREDICTORS:
        raise InvalidInputError(f"RR predictor '{predictor}' is unknown; choose {', '.join(PREDICTORS)}")
    duration_s = len(signal) / signal.rate_hz
    t_s = signal.start_s + np.arange(max(1, int(duration_s * rate_hz))) / rate_hz
    options = PhaseClockOptions(predictor=predictor)
    return track_phase(signal, t_s, options=options)


def _result(tracking: "PhaseTracking", *, with_phase: bool) -> dict[str, Any]:
    from dvf_ig.cardiac import summarise_gating

    summary = summarise_gating(tracking.peaks, tracking.track)
    result: dict[str, Any] = {
        "beats_s": [peak.t_s for peak in tracking.peaks],
        "detected_at_s": [peak.detected_at_s for peak in tracking.peaks],
        "rate_bpm": summary.rate_bpm,
        "valid_share": summary.valid_share,
        "invalid_segments_s": summary.invalid_segments_s.tolist(),
    }
    if with_phase:
        track = tracking.track
        result["phase"] = {
            "t_s": track.t_s.tolist(),
            "phi": track.phi.tolist(),
            "valid": track.valid.tolist(),
        }
    return result


def _rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    segments = result["invalid_segments_s"]
    shown = ", ".join(f"{start:.1f}–{stop:.1f}" for start, stop in segments[:8])
    more = f" and {len(segments) - 8} more" if len(segments) > 8 else ""
    delays = sorted(
        known - peak for known, peak in zip(result["detected_at_s"], result["beats_s"], strict=True)
    )
    return [
        ("beats", f"{len(result['beats_s'])}"),
        ("rate", f"{result['rate_bpm']:.1f} /min"),
        ("known after", f"{1000 * delays[len(delays) // 2]:.0f} ms (median)"),
        ("phase valid", f"{100 * result['valid_share']:.1f} % of the time"),
        ("not valid", f"{shown}{more} s" if segments else "never"),
    ]
