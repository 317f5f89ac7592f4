"""One trial: a quiet recording of one heart, and shifts and drifts of the heart put into its beats."""

from typing import Any

import numpy as np

from data_synth import ScenarioSpec, child_rng, phantom_scenario
from dvf_ig.core import FloatArray, mean_displacement_mm
from dvf_ig.registration import ShiftDetector
from dvf_ig.session import RegistrationMonitor
from dvf_ig.session.ultrasound.beat_evaluation import evaluation_of
from dvf_ig.study.hearts.registered import MOTION, VARIED
from dvf_ig.study.trials import Line, Settings

from .recording import DisplacedBeat, WatchedBeat, WatchedRecording, moved, watch_recording

SHIFTS_MM = (4.0, 8.0)
ONSET_EVERY, FIRST_ONSET, FOLLOWED_BEATS = 6, 4, 10
"""A shift begins at every sixth beat from the fifth on; each is followed for ten beats at most."""
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
    """What the watch said of the recording as it is, and with a heart that moves."""
    beats, rng = recording.beats, child_rng(number, "watch trial")
    onsets = range(FIRST_ONSET, len(beats) - FOLLOWED_BEATS, ONSET_EVERY)
    off_mm = [mean_displacement_mm(b.estimate.pose, recording.truth, recording.center_mm) for b in beats]
    bounds = [b.estimate.tre_bound_mm for b in beats]
    return {
        "beats": len(beats),
        "guided_s": round(recording.guided_s, 2),
        "unconfirmed_s": round(recording.unconfirmed_s, 2),
        "alarms": list(recording.alarms),
        "statistic": [round(x, 2) for x in statistics(beats)],
        "tre_mm": _rounded(off_mm),
        "tre_bound_mm": _rounded(bounds),
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


def detectors(beats: tuple[WatchedBeat, ...]) -> list[ShiftDetector]:
    """The detector before each beat, and after the last."""
    found = [ShiftDetector()]
    for beat in beats:
        measurement = beat.evaluation.measurement
        found.append(
            found[-1].after(beat.evaluation.begin_s, beat.estimate, measurement)
            if measurement.informative
            else found[-1]
        )
    return found


def statistics(beats: tuple[WatchedBeat, ...]) -> list[float]:
    """The statistic of `ShiftDetector` after each beat."""
    tests = [detector.test for detector in detectors(beats)[1:]]
    return [0.0 if test is None else test.statistic for test in tests]


def monitor_before(recording: WatchedRecording, first: int) -> RegistrationMonitor:
    """The monitor as it was before a beat."""
    return RegistrationMonitor(
        recording.center_mm,
        None,
        estimate=recording.beats[first].estimate,
        suspended=False,
        shift=detectors(recording.beats[:first])[-1],
    )


def beats_until_found(recording: WatchedRecording, first: int, shift_mm: FloatArray) -> int | None:
    """Beats from the shift at the beginning of beat `first` on, with the one that suspends the pose.

    None where FOLLOWED_BEATS do not. No registration takes part: it comes every 12 s, and would only find
    the shift sooner.
    """
    monitor = monitor_before(recording, first)
    for count, beat in enumerate(recording.beats[first : first + FOLLOWED_BEATS], start=1):
        monitor = _after(monitor, DisplacedBeat(beat.slices, shift_mm))
        if monitor.in_use is None:
            return count
    return None


def followed_drift(recording: WatchedRecording, mm_per_s: FloatArray) -> Line | None:
    """A drift from the fifth beat to the last: how far the pose in use lags, and whether it is found.

    The lag is against the pose that the session had without a drift, displaced as the heart was. It counts
    while the pose is in use.
    """
    beats = recording.beats[FIRST_ONSET:]
    if not beats:
        return None
    monitor, lag_mm, found_s = monitor_before(recording, FIRST_ONSET), 0.0, None
    for beat in beats:
        since_s = beat.slices.end_s - beats[0].slices.begin_s
        gone_mm = mm_per_s * since_s
        monitor = _after(monitor, DisplacedBeat(beat.slices, gone_mm))
        if monitor.in_use is None:
            found_s = since_s
            break
        there = moved(beat.estimate.pose, gone_mm)
        lag_mm = max(lag_mm, mean_displacement_mm(monitor.in_use.pose, there, recording.center_mm))
    return {"lag_mm": round(lag_mm, 2), "found_s": found_s, "seconds": round(since_s, 1)}


def _after(monitor: RegistrationMonitor, beat: DisplacedBeat) -> RegistrationMonitor:
    if monitor.in_use is None:
        return monitor
    found = evaluation_of(beat, monitor.in_use, monitor.center_mm, in_use=True)
    return monitor if found is None else monitor.after_beat(found)
