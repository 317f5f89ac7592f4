"""Faults put into streams: what a stream, the heart, the hand or the patient does instead of the normal."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import cycle
from statistics import median

import numpy as np

from data_synth.signals.rhythm import Beats
from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.session import EcgSamples, Event, ToolPose, TrackedFrame
from dvf_ig.study.faults.streams import ECG_HZ, Arrivals, Coordinates, TipPath, circling


@dataclass(frozen=True, slots=True)
class When:
    """A fault's begin and end, s."""

    begin_s: float
    end_s: float


ArrivalsChange = Callable[[Arrivals, When], Arrivals]
SamplesChange = Callable[[FloatArray, When, np.random.Generator], FloatArray]
BeatsChange = Callable[[Beats, When, np.random.Generator], tuple[Beats, When]]
"""The beats with the fault, and from which R peak to which the rhythm is not regular."""
TipChange = Callable[[When], TipPath]
PatientChange = Callable[[When, np.random.Generator], Coordinates]


@read_only_arrays
@dataclass(frozen=True, slots=True)
class Fault:
    """Changes that a fault makes to each stream; None leaves a stream alone.

    Attributes:
        tool, frames, ecg: what arrives.
        samples: the ECG before it is cut into packets.
        beats: of the heart.
        tip: where the tip moves.
        patient: where the patient is.
        registered: where registrations put the patient.
    """

    tool: ArrivalsChange | None = None
    frames: ArrivalsChange | None = None
    ecg: ArrivalsChange | None = None
    samples: SamplesChange | None = None
    beats: BeatsChange | None = None
    tip: TipChange | None = None
    patient: PatientChange | None = None
    registered: PatientChange | None = None


def missing(arrivals: Arrivals, when: When) -> Arrivals:
    """Remove everything that arrives."""
    inside = _inside(arrivals, when)
    return [*arrivals[: inside.start], *arrivals[inside.stop :]]


def not_tracked(arrivals: Arrivals, when: When) -> Arrivals:
    """The tracker does not report OK."""
    return _events_changed(arrivals, when, lambda event: _with_pose(event, None))


def without_image(arrivals: Arrivals, when: When) -> Arrivals:
    """Frames of an ultrasound machine that shows nothing."""

    def blank(event: Event) -> Event:
        return replace(event, image=None) if isinstance(event, TrackedFrame) else event

    return _events_changed(arrivals, when, blank)


def frozen(arrivals: Arrivals, when: When) -> Arrivals:
    """The last pose before is reported again and again, bit for bit, with status OK."""
    last_pose = _pose_of(arrivals[_inside(arrivals, when).start - 1][1])
    return _events_changed(arrivals, when, lambda event: _with_pose(event, last_pose))


def not_finite(arrivals: Arrivals, when: When) -> Arrivals:
    """One number of each pose is NaN."""

    def broken(event: Event) -> Event:
        pose = _pose_of(event)
        if pose is None:
            return event
        matrix = pose.copy()
        matrix[1, 3] = np.nan
        return _with_pose(event, matrix)

    return _events_changed(arrivals, when, broken)


def scaled(factor: float) -> ArrivalsChange:
    """Poses whose rotation is scaled along one axis."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        def stretched(event: Event) -> Event:
            pose = _pose_of(event)
            return event if pose is None else _with_pose(event, pose @ np.diag([factor, 1.0, 1.0, 1.0]))

        return _events_changed(arrivals, when, stretched)

    return change


def alternating(by_mm: float) -> ArrivalsChange:
    """Every other pose is that of another tool, which another program sends."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        turns = cycle((True, False))

        def elsewhere(event: Event) -> Event:
            pose = _pose_of(event)
            if pose is None or not next(turns):
                return event
            matrix = pose.copy()
            matrix[0, 3] += by_mm
            return _with_pose(event, matrix)

        return _events_changed(arrivals, when, elsewhere)

    return change


def late(by_s: float) -> ArrivalsChange:
    """Everything arrives later; the link keeps the order."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        inside = _inside(arrivals, when)
        out, newest_s = [], -np.inf
        for k, (arrived_s, event) in enumerate(arrivals):
            newest_s = max(newest_s, arrived_s + (by_s if inside.start <= k < inside.stop else 0.0))
            out.append((newest_s, event))
        return out

    return change


def stamped_back(by_s: float) -> ArrivalsChange:
    """The source's clock goes back, and on its old way at the end."""
    return lambda arrivals, when: _events_changed(
        arrivals, when, lambda event: stamped(event, stamp_of(event) - by_s)
    )


def drifting(rate: float) -> ArrivalsChange:
    """The source's clock gains `rate` seconds a second, and keeps what it gained."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        out = []
        for arrived_s, event in arrivals:
            t_s = stamp_of(event)
            gained_s = rate * (min(max(t_s, when.begin_s), when.end_s) - when.begin_s)
            out.append((arrived_s, stamped(event, t_s + gained_s) if gained_s else event))
        return out

    return change


def repeated(share: float) -> ArrivalsChange:
    """So large a share of what arrives comes a second time."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        inside, out, owed = _inside(arrivals, when), [], 0.0
        for k, arrival in enumerate(arrivals):
            out.append(arrival)
            if inside.start <= k < inside.stop:
                owed += share / (1.0 - share)
                while owed >= 1.0:
                    out.append(arrival)
                    owed -= 1.0
        return out

    return change


def stamp_of(event: Event) -> float:
    """When the source says it was."""
    return event.start_s if isinstance(event, EcgSamples) else event.t_s


def stamped(event: Event, t_s: float) -> Event:
    """The event with another stamp."""
    if isinstance(event, EcgSamples):
        return EcgSamples(t_s, event.samples)
    return replace(event, t_s=t_s)


def _inside(arrivals: Arrivals, when: When) -> slice:
    """As many events from the begin on as usually fall between begin and end."""
    stamps = [stamp_of(event) for _, event in arrivals]
    first = int(np.searchsorted(stamps, when.begin_s))
    usual_s = median(np.diff(stamps[:100]).tolist())
    return slice(first, min(len(stamps), first + max(1, round((when.end_s - when.begin_s) / usual_s))))


def _events_changed(arrivals: Arrivals, when: When, change: Callable[[Event], Event]) -> Arrivals:
    inside = _inside(arrivals, when)
    changed = [(arrived_s, change(event)) for arrived_s, event in arrivals[inside]]
    return [*arrivals[: inside.start], *changed, *arrivals[inside.stop :]]


def _pose_of(event: Event) -> FloatArray | None:
    if isinstance(event, ToolPose):
        return event.tracker_from_tool
    return event.tracker_from_probe if isinstance(event, TrackedFrame) else None


def _with_pose(event: Event, matrix: FloatArray | None) -> Event:
    if isinstance(event, ToolPose):
        return ToolPose(event.t_s, matrix)
    return replace(event, tracker_from_probe=matrix) if isinstance(event, TrackedFrame) else event


BOX_MM = 40.0
"""Half the edge of the wall's model."""
LEAVING_MM_S = 30.0
"""Speed of a tip that leaves the model's box."""


def leaving(beyond_mm: float) -> TipChange:
    """The tip crosses the border of the model's box as the fault begins, and again as it ends."""

    def change(when: When) -> TipPath:
        over_s = min(beyond_mm / LEAVING_MM_S, 0.5 * (when.end_s - when.begin_s))
        far = BOX_MM + LEAVING_MM_S * over_s
        from_s = BOX_MM / LEAVING_MM_S
        knots_s = [when.begin_s - from_s, when.begin_s + over_s, when.end_s - over_s, when.end_s + from_s]

        def tip(t_s: FloatArray) -> FloatArray:
            at = circling(t_s)
            at[:, 1] = np.interp(t_s, knots_s, [0.0, far, far, 0.0])
            return at

        return tip

    return change


def moved_by(by_mm: float) -> PatientChange:
    """The patient moves within half a second and stays there."""
    return lambda when, rng: _shifted(by_mm, when.begin_s, 0.5, rng)


def breathing_by(by_mm: float) -> PatientChange:
    """The patient breathes, BREATHS_A_MINUTE, and nothing follows it."""

    def change(when: When, rng: np.random.Generator) -> Coordinates:
        away = by_mm * _direction(rng)

        def there(t_s: float) -> FloatArray:
            if not when.begin_s <= t_s < when.end_s:
                return np.zeros(6)
            return np.asarray(away * np.sin(np.pi * BREATHS_A_MINUTE / 60.0 * (t_s - when.begin_s)) ** 2)

        return there

    return change


def registered_off(by_mm: float) -> PatientChange:
    """Registrations that are asked for meanwhile put the heart elsewhere; it did not move."""

    def change(when: When, rng: np.random.Generator) -> Coordinates:
        away = by_mm * _direction(rng)
        return lambda t_s: away if when.begin_s <= t_s < when.end_s else np.zeros(6)

    return change


def _shifted(by_mm: float, begin_s: float, over_s: float, rng: np.random.Generator) -> Coordinates:
    away = by_mm * _direction(rng)
    return lambda t_s: away * min(1.0, max(0.0, (t_s - begin_s) / over_s))


def _direction(rng: np.random.Generator) -> FloatArray:
    """A unit translation in the coordinates of a pose."""
    v = rng.standard_normal(3)
    return np.concatenate([np.zeros(3), v / np.linalg.norm(v)])


BREATHS_A_MINUTE = 14.0
EARLY = 0.65
"""An early beat comes after this share of the interval."""
FIBRILLATION_CV = 0.25
"""Standard deviation over mean of intervals in atrial fibrillation."""


def flat(samples: FloatArray, when: When, rng: np.random.Generator) -> FloatArray:
    """Electrodes off: all leads hold one value."""
    return _samples_changed(samples, when, lambda part: np.broadcast_to(part[:1], part.shape))


def unplugged(samples: FloatArray, when: When, rng: np.random.Generator) -> FloatArray:
    """The recorder marks samples as missing."""
    return _samples_changed(samples, when, lambda part: np.full(part.shape, np.nan))


def mains_hum(samples: FloatArray, when: When, rng: np.random.Generator) -> FloatArray:
    """Electrodes off: open leads that pick up mains and noise in place of the heart."""

    def hum(part: FloatArray) -> FloatArray:
        t_s = np.arange(len(part)) / ECG_HZ
        wave = np.sin(2.0 * np.pi * 50.0 * t_s + rng.uniform(0.0, 2.0 * np.pi))
        return np.asarray(wave[:, None] + 0.05 * rng.standard_normal(part.shape))

    return _samples_changed(samples, when, hum)


def early_beats(count: int) -> BeatsChange:
    """So many ventricular extrasystoles in a row, and the pause after them."""

    def change(beats: Beats, when: When, rng: np.random.Generator) -> tuple[Beats, When]:
        r_s = beats.r_peaks_s
        k = int(np.searchsorted(r_s, when.begin_s))
        usual_s = float(r_s[k] - r_s[k - 1])
        run = r_s[k - 1] + EARLY * usual_s * np.arange(1, count + 1)
        after = r_s[r_s > run[-1] + (1.9 - EARLY) * usual_s]
        together = np.concatenate([r_s[:k], run, after])
        wide = (together >= run[0]) & (together <= run[-1])
        return Beats(together, wide), When(float(run[0]), float(after[0]))

    return change


def fibrillation(beats: Beats, when: When, rng: np.random.Generator) -> tuple[Beats, When]:
    """Intervals that follow no rule."""
    r_s = beats.r_peaks_s
    before, after = r_s[r_s < when.begin_s], r_s[r_s > when.end_s]
    usual_s = float(np.median(np.diff(before[-10:])))
    wild, last_s = [], float(before[-1])
    while last_s < when.end_s - 2.0 * usual_s:
        last_s += usual_s * float(np.clip(1.0 + FIBRILLATION_CV * rng.standard_normal(), 0.45, 1.8))
        wild.append(last_s)
    together = np.concatenate([before, wild, after])
    return Beats(together, np.zeros(len(together), dtype=np.bool_)), When(wild[0], wild[-1])


def _samples_changed(
    samples: FloatArray, when: When, change: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    first, last = (round(ECG_HZ * t_s) for t_s in (when.begin_s, when.end_s))
    return np.concatenate([samples[:first], change(samples[first:last]), samples[last:]])
