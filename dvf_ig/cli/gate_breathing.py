"""Breathing in `dvf-ig gate`: its rate, states and events, as JSON, rows and a picture."""

from pathlib import Path
from typing import Any

from .shell import progress

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
