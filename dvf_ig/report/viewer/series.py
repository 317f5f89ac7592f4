"""Encode the time series of a completed run: ticks by their columns, signals, ultrasound frames and marks."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dvf_ig.core import PhaseState
from dvf_ig.core.arrays import AnyArray, FloatArray, read_only_arrays
from dvf_ig.guidance import Hazard, Tool
from dvf_ig.guidance.servo import SentForce
from dvf_ig.session import GuidanceState

from .frames import FrameSeries, frames_payload
from .packing import packed, packed_times

AXES = "xyz"
TIP = tuple(f"tip_mr_{axis}_mm" for axis in AXES)
SHAFT = tuple(f"shaft_mr_{axis}" for axis in AXES)
FORCE_TRACKER = tuple(f"force_tracker_{axis}_n" for axis in AXES)
FORCE_MR = tuple(f"force_mr_{axis}_n" for axis in AXES)

STEPS: dict[str, float] = {
    "t_s": 1e-6,
    "phi": 1e-6,
    "phase_valid": 1.0,
    "model_phase": 1e-6,
    "rr_s": 1e-6,
    **dict.fromkeys(TIP, 1e-4),
    **dict.fromkeys(SHAFT, 1e-3),
    "distance_mm": 1e-4,
    **dict.fromkeys(FORCE_TRACKER, 1e-6),
    **dict.fromkeys(FORCE_MR, 1e-5),
    "status": 1.0,
    "supervisor": 1.0,
    "hazards": 1.0,
    "pose_age_s": 1e-3,
    "pose_bound_mm": 1e-3,
    "margin_mm": 1e-4,
}
"""Rounding step of each column, as in `ticks.csv`; `force_mr` and `shaft_mr` are not in that file."""


MOST_TICKS = 120_000
"""Most ticks, those of two minutes; of longer runs every second, third, … is kept."""
SIGNAL_RATE_HZ = 250.0
SIGNAL_STEPS = 20_000
"""Steps between zero and the largest sample of a signal."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SampledSignal:
    """Samples (n,) of an ECG or of breathing at (n,) times."""

    t_s: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class Mark:
    """An event at one time.

    Attributes:
        kind: "registration", "refused" or "suspended".
        text: a sentence.
        bound_mm: 95 % bound on the largest error over the heart, of a registration that states one.
        until_s: end of an event that lasted; None for one that did not.
    """

    t_s: float
    kind: str
    text: str
    until_s: float | None = None
    bound_mm: float | None = None


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SeriesInput:
    """Everything over time.

    Attributes:
        ticks: columns by the names in `columns.STEPS`; NaN if a value is unknown.
        ecg, breathing: None without such a signal.
        r_peaks_s: detected R peaks.
        frames: None without ultrasound.
        marks: in order of time.
    """

    ticks: Mapping[str, AnyArray]
    ecg: SampledSignal | None
    breathing: SampledSignal | None
    r_peaks_s: FloatArray
    frames: FrameSeries | None
    marks: Sequence[Mark]


def series_payload(series: SeriesInput) -> dict[str, Any]:
    """Build the field `series` of a page's scene (`dvf_ig/report/web/README.md`)."""
    every = -(-len(series.ticks["t_s"]) // MOST_TICKS)
    ticks = {
        name: packed(np.asarray(series.ticks[name])[::every], step, delta=True)
        for name, step in STEPS.items()
        if name != "t_s"
    }
    return {
        "ticks": {"t_s": packed_times(np.asarray(series.ticks["t_s"])[::every]), **ticks},
        "ecg": _signal(series.ecg),
        "breathing": _signal(series.breathing),
        "r_peaks_s": series.r_peaks_s.round(6).tolist(),
        "frames": None if series.frames is None else frames_payload(series.frames),
        "marks": [asdict(mark) for mark in series.marks],
    }


def _signal(signal: SampledSignal | None) -> dict[str, Any] | None:
    """Encode every n-th sample, so that the rate does not exceed SIGNAL_RATE_HZ."""
    if signal is None or len(signal.t_s) < 2:
        return None
    every = max(1, int(1.0 / (SIGNAL_RATE_HZ * float(np.median(np.diff(signal.t_s)))) + 1e-6))
    t_s, values = signal.t_s[::every], signal.values[::every]
    largest = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    return {"t_s": packed_times(t_s), "values": packed(values, largest / SIGNAL_STEPS, delta=True)}


_DECIMALS = {name: max(0, round(-np.log10(step))) for name, step in STEPS.items()}


def state_event(state: GuidanceState, tool: Tool, sent: SentForce | None = None) -> dict[str, Any]:
    """Build the fields that every live event has (`dvf_ig/report/web/README.md`).

    The caller adds new data: `ecg`, `r_peaks_s`, `frame` (see `frame_event`) and `marks`.

    Args:
        tool: on which the fixtures act.
        sent: force of a haptic device's own servo, which is shown then.
    """
    now_s, phase, transform = state.now_s, state.phase, state.transform
    force_n = state.force_n if sent is None else sent.force_n
    tip, shaft, force_mr = (np.full(3, np.nan) for _ in range(3))
    if transform.pose is not None and now_s < transform.pose_until_s:
        pose = transform.pose.at(now_s)
        force_mr = pose.rotation @ force_n
        if not state.tool.hazard:
            tip = pose.apply_array(state.tool.tip_tracker_mm)
            tip_mm, turn = state.calibrations.tip.xyz_mm[0], state.tool.rotation[None]
            shaft = pose.rotation @ tool.handle_direction(tip_mm, state.tool.tip_tracker_mm[None], turn)[0]
    numbers = {
        "t_s": now_s,
        "phi": phase.phi,
        "phase_valid": int(phase.state is PhaseState.LOCKED),
        "model_phase": state.model_phase,
        "rr_s": phase.rr_s,
        **_axes(TIP, tip),
        **_axes(SHAFT, shaft),
        "distance_mm": state.distance_mm,
        **_axes(FORCE_TRACKER, force_n),
        **_axes(FORCE_MR, force_mr),
        "pose_age_s": state.pose_age_s,
        "pose_bound_mm": state.pose_bound_mm,
        "margin_mm": float(state.margin_mm[0]),
    }
    hazards = Hazard(state.supervised.hazards) if sent is None else sent.hazards
    return {
        **{
            name: round(value, _DECIMALS[name]) if np.isfinite(value) else None
            for name, value in numbers.items()
        },
        "status": state.status.name.lower(),
        "supervisor": (state.supervisor if sent is None else sent.state).name.lower(),
        "hazards": "|".join(one.name.lower() for one in hazards if one.name),
    }


def _axes(names: tuple[str, ...], vector: FloatArray) -> dict[str, float]:
    return dict(zip(names, vector.tolist(), strict=True))
