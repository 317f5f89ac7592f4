"""Watch over a pose in use while nothing happens, and while the heart is shifted or drifts.

Alarms of quiet recordings are false; their rate has the exact Poisson interval. Shifts of 4 and 8 mm and
drifts of 1, 3 and 10 mm a minute are put into the recorded beats; shares have intervals over hearts. The
unit is the heart.

    dvf-ig study watch --list tuning --hearts 3 -o study
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from data_synth import ScenarioSpec, child_rng, phantom_scenario
from dvf_ig.core import FloatArray
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials
from dvf_ig.study.hearts.recordings import MOTION, VARIED, ListName, heart_list, hearts_option, list_option
from dvf_ig.study.options import option
from dvf_ig.study.statistics import Estimate, estimate_text, number_text, poisson_rate, share_over_hearts

from .beats import (
    FIRST_ONSET,
    FOLLOWED_BEATS,
    WatchedRecording,
    beats_until_found,
    followed_drift,
    statistics,
    watch_recording,
)


@dataclass(frozen=True, kw_only=True)
class WatchSettings:
    """Options of the study."""

    list: ListName = list_option()
    preset: str = option("A preset in which neither patient nor probe moves.", "calm")
    seconds: float = option("Length of each recording.", 60.0)
    hearts: int | None = hearts_option()


SHIFTS_MM = (4.0, 8.0)
ONSET_EVERY = 6
"""A shift begins at every sixth beat from FIRST_ONSET on."""
DRIFTS_MM_PER_MIN = (1.0, 3.0, 10.0)


def watch_trial(settings: Settings, number: int) -> Line:
    """One heart.

    Args:
        settings: `preset`, `seconds`.
        number: seed of the heart.
    """
    motion: Any = MOTION[number % 2]
    spec = ScenarioSpec(settings["preset"], motion, settings["seconds"], number, heart=VARIED)
    return measured(watch_recording(phantom_scenario(spec), number), number)


def measured(recording: WatchedRecording, number: int) -> Line:
    """Evaluate the watch on the recording as it is, and with a heart that moves."""
    beats, rng = recording.beats, child_rng(number, "watch trial")
    onsets = range(FIRST_ONSET, len(beats) - FOLLOWED_BEATS, ONSET_EVERY)
    bounds = [b.estimate.pose_bound_mm for b in beats]
    return {
        "beats": len(beats),
        "guided_s": round(recording.guided_s, 2),
        "unconfirmed_s": round(recording.unconfirmed_s, 2),
        "alarms": list(recording.alarms),
        "statistic": [round(x, 2) for x in statistics(beats)],
        "error_mm": _rounded([b.error_mm for b in beats]),
        "bound_mm": _rounded(bounds),
        "shifts": {
            f"{mm:g}": [beats_until_found(recording, first, mm * _direction(rng)) for first in onsets]
            for mm in SHIFTS_MM
        },
        "drifts": {
            f"{rate:g}": followed_drift(recording, rate / 60.0 * _direction(rng))
            for rate in DRIFTS_MM_PER_MIN
        },
    }


def _rounded(values: list[float]) -> list[float]:
    return [round(value, 3) for value in values]


def _direction(rng: np.random.Generator) -> FloatArray:
    drawn = rng.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


WITHIN_BEATS = (1, 2, 3, 5, 10)


@dataclass(frozen=True, slots=True)
class ShiftSummary:
    """Shifts of one length.

    Attributes:
        mm: length; shifts: how many.
        within: number of beats to the share that is found within them.
        median_beats: until found.
    """

    mm: float
    shifts: int
    within: dict[str, Estimate]
    median_beats: float | None


@dataclass(frozen=True, slots=True)
class DriftSummary:
    """Drifts of one speed.

    Attributes:
        mm_per_min: speed; drifts: how many, one a heart.
        found: of them, by a suspension; the others were followed to the end.
        lag_median_mm, lag_max_mm: largest lag of the pose while it was in use, over hearts.
    """

    mm_per_min: float
    drifts: int
    found: int
    lag_median_mm: float | None
    lag_max_mm: float | None


@dataclass(frozen=True, slots=True)
class WatchSummary:
    """All hearts of one preset.

    Attributes:
        hearts: trials; failed: those that ended in an error.
        beats: compared with a pose in use; hours: with one.
        alarms: false ones, as the user saw them; alarms_per_hour.
        unconfirmed_s: time with a pose that no beat confirmed.
        statistic_p99, statistic_max: of the shift detector, quiet.
        error_median_mm, bound_median_mm: of the pose in use or the guarded walls of a heart whose shape is
            followed, and of its stated 95 % bound.
        bound_covers: share of beats whose error is within its bound.
    """

    hearts: int
    failed: int
    beats: int
    hours: float
    alarms: tuple[str, ...]
    alarms_per_hour: Estimate
    unconfirmed_s: float
    statistic_p99: float | None
    statistic_max: float | None
    error_median_mm: float | None
    bound_median_mm: float | None
    bound_covers: Estimate
    shifts: tuple[ShiftSummary, ...]
    drifts: tuple[DriftSummary, ...]


def summarise_watch(lines: Sequence[Line]) -> WatchSummary:
    """Everything about one preset."""
    completed = [line for line in lines if "refused" not in line]
    quiet = [x for line in completed for x in line["statistic"]]
    alarms = tuple(alarm for line in completed for alarm in line["alarms"])
    hours = sum(line["guided_s"] for line in completed) / 3600.0
    return WatchSummary(
        hearts=len(lines),
        failed=len(lines) - len(completed),
        beats=sum(line["beats"] for line in completed),
        hours=hours,
        alarms=alarms,
        alarms_per_hour=poisson_rate(len(alarms), hours),
        unconfirmed_s=sum(line["unconfirmed_s"] for line in completed),
        statistic_p99=float(np.percentile(quiet, 99)) if quiet else None,
        statistic_max=max(quiet, default=None),
        error_median_mm=_median([x for line in completed for x in line["error_mm"]]),
        bound_median_mm=_median([x for line in completed for x in line["bound_mm"]]),
        bound_covers=share_over_hearts([_covered(line) for line in completed]),
        shifts=tuple(_shifts(mm, completed) for mm in SHIFTS_MM),
        drifts=tuple(_drifts(rate, completed) for rate in DRIFTS_MM_PER_MIN),
    )


def _covered(line: Line) -> list[bool]:
    return [off <= bound for off, bound in zip(line["error_mm"], line["bound_mm"], strict=True)]


def _shifts(mm: float, completed: Sequence[Line]) -> ShiftSummary:
    of_hearts = [line["shifts"][f"{mm:g}"] for line in completed]
    every = [np.inf if k is None else float(k) for trials in of_hearts for k in trials]
    within = {
        str(n): share_over_hearts([[k is not None and k <= n for k in trials] for trials in of_hearts])
        for n in WITHIN_BEATS
    }
    return ShiftSummary(mm, len(every), within, _median(every))


def _drifts(rate: float, completed: Sequence[Line]) -> DriftSummary:
    drifts = [line["drifts"][f"{rate:g}"] for line in completed]
    drifts = [drift for drift in drifts if drift is not None]
    lags = [drift["lag_mm"] for drift in drifts]
    suspended = sum(drift["found_s"] is not None for drift in drifts)
    return DriftSummary(rate, len(drifts), suspended, _median(lags), max(lags, default=None))


def _median(values: Sequence[float]) -> float | None:
    middle = float(np.median(values)) if values else np.inf
    return middle if np.isfinite(middle) else None


def run(settings: WatchSettings, driver: Driver) -> Result:
    """Watch every heart of the list."""
    checked = ScenarioSpec(preset=settings.preset, seconds=settings.seconds)
    fields = {"preset": checked.preset, "seconds": checked.seconds}
    hearts = heart_list(settings.list).first_world[: settings.hearts]
    result = summarise_watch(driver.trials(Trials("watch", fields, watch_trial), hearts))
    summary = {"list": settings.list, **fields, **asdict(result)}
    return Result(summary, _table(result), {"summary.json": summary})


def _table(result: WatchSummary) -> Rows:
    rows = [
        ("hearts (failed)", f"{result.hearts} ({result.failed})"),
        ("quiet beats", f"{result.beats} in {result.hours:.2f} h"),
        ("false alarms", str(len(result.alarms))),
        ("false alarms an hour", estimate_text(result.alarms_per_hour)),
        ("unconfirmed s", f"{result.unconfirmed_s:.1f}"),
        (
            "shift statistic, 99 %, largest",
            f"{number_text(result.statistic_p99)}, {number_text(result.statistic_max)}",
        ),
        (
            "error, bound, median mm",
            f"{number_text(result.error_median_mm)}, {number_text(result.bound_median_mm)}",
        ),
        ("bound covers", estimate_text(result.bound_covers, "{:.0%}")),
    ]
    for shift in result.shifts:
        rows += [
            (f"{shift.mm:g} mm found within {beats} beats", estimate_text(share, "{:.0%}"))
            for beats, share in shift.within.items()
        ]
    rows += [
        (
            f"drift of {drift.mm_per_min:g} mm/min",
            f"found in {drift.found} of {drift.drifts}; lag {number_text(drift.lag_median_mm)} mm, "
            f"at most {number_text(drift.lag_max_mm)}",
        )
        for drift in result.drifts
    ]
    return [("", f"{result.hearts} hearts"), *rows]


STUDY = Study(WatchSettings, run)
