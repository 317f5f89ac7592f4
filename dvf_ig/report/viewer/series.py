"""Encode the time series of a completed run: ticks by their columns, signals, ultrasound frames and marks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dvf_ig.core.arrays import AnyArray, FloatArray, read_only_arrays

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
