"""Follow breaths through their events, without images: what is served at which error, and what is withheld.

The breath moves a heart; each of its beats is measured with NOISE_MM of noise, as slices measure it. What
follows the breath is a ventilator's channel or a chest marker, late by 0 to 200 ms, or the ECG alone. Events
are at EVENT_S, when the motion has been learnt; `left_mm` is the largest error with a force after it,
`withheld_s` the time from where the breath leaves what was learnt to where the pose is withheld, and
`back_breaths` how many breaths after it has ended the pose is in use again. Errors are of the moment, mean
over points 40 mm from the heart's centre. The unit is the seed; nothing is tuned to those of this study.

    dvf-ig study breathing --seeds 10 --seed 5001 -o study
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth import PRESETS, EcgSpec, RhythmSpec, beat_series, synthetic_ecg
from data_synth.breathing.breaths import BreathEvent, BreathSpec, draw_breaths
from data_synth.breathing.motion import Breathing, breathing_of
from data_synth.breathing.recorded import recorded_breathing
from dvf_ig.cardiac import detect_r_peaks
from dvf_ig.core import HEART_RADIUS_MM, BoolArray, FloatArray, PoseMotion, Respiration, Rigid
from dvf_ig.registration import BeatMeasurement
from dvf_ig.session import EcgSamples, RespirationSample
from dvf_ig.session.breathing import BreathingRecord, BreathingTracker, no_log
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials
from dvf_ig.study.options import option, seed_option, seeds_option

CENTER = np.zeros(3)
NOISE_MM = 0.45
"""Of a beat's measurement of the pose, along each coordinate."""
BEYOND_VOLUME = 1.3
"""No ordinary breath of these worlds is deeper."""
FIRST_BEAT_S = 14.0
LEARNT_S, EVENT_S = 66.0, 90.0
PERMANENT = ("doubled-rate", "deepened")
GRID = 40.0 * np.vstack([np.eye(3), -np.eye(3)])
RESTING = PoseMotion.still(Rigid.from_rotation_vector([0.4, 0.1, -0.3], [20.0, 5.0, 9.0], "mr", "tracker"))
VENTILATED, SPONTANEOUS = (PRESETS[name].respiration for name in ("ventilated", "breathing"))
STILL = BreathSpec()
SINUS = RhythmSpec()
STILL_VIEW_MM = np.zeros((3, 3))


@dataclass(frozen=True, kw_only=True)
class BreathingSettings:
    """Options of the study."""

    seconds: float = option("Length of each recording.", 150.0, least=110.0)
    seeds: int = seeds_option(10)
    seed: int = seed_option(5001)


class Way(NamedTuple):
    """What a heart does, and what follows its breath.

    Attributes:
        spec: of the breath.
        recorded: a channel or marker follows it; otherwise the ECG may.
        late_s: delay of that channel, added to its own.
        rhythm: of the heart.
    """

    spec: BreathSpec
    recorded: bool = True
    late_s: float = 0.0
    rhythm: RhythmSpec = SINUS


def _with(event: BreathEvent) -> BreathSpec:
    return replace(VENTILATED, events=((event, EVENT_S),))


WAYS: dict[str, Way] = {
    "ventilated": Way(VENTILATED),
    "spontaneous": Way(SPONTANEOUS),
    "50 ms late": Way(VENTILATED, late_s=0.05),
    "100 ms late": Way(VENTILATED, late_s=0.1),
    "200 ms late": Way(VENTILATED, late_s=0.2),
    "cough": Way(_with("cough")),
    "pause": Way(_with("pause")),
    "disconnection": Way(_with("disconnection")),
    "one breath of 1.8": Way(_with("sigh")),
    "doubled rate": Way(_with("doubled-rate")),
    "deeper for good": Way(_with("deepened")),
    "by the ECG": Way(VENTILATED, recorded=False),
    "by the ECG, cough": Way(_with("cough"), recorded=False),
    "by the ECG, pause": Way(_with("pause"), recorded=False),
    "by the ECG, disconnection": Way(_with("disconnection"), recorded=False),
    "by the ECG, one breath of 1.8": Way(_with("sigh"), recorded=False),
    "by the ECG, doubled rate": Way(_with("doubled-rate"), recorded=False),
    "no breathing": Way(STILL, recorded=False),
    "no breathing, ectopic beats": Way(STILL, recorded=False, rhythm=RhythmSpec(ectopic_share=0.1)),
    "no breathing, atrial fibrillation": Way(STILL, recorded=False, rhythm=RhythmSpec(jitter=0.2)),
}


Log = Callable[[BreathingRecord], None]


class Followed(NamedTuple):
    """A recording, followed.

    Attributes:
        t_s: (n,) every 0.1 s.
        error_mm: (n,) mean over the heart.
        withheld: (n,) whether the pose was.
        tracker: after it.
    """

    t_s: FloatArray
    error_mm: FloatArray
    withheld: BoolArray
    tracker: BreathingTracker


def breathing_world(spec: BreathSpec, until_s: float, seed: int) -> tuple[Breathing, Respiration]:
    """Draw a heart that breathes, and the channel that records it."""
    rng = np.random.default_rng(seed)
    breathing = breathing_of(spec, draw_breaths(spec, until_s, rng), CENTER, rng)
    if breathing is None:
        raise TypeError("this heart does not breathe")

    def still(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.repeat(np.eye(3)[None], len(t_s), axis=0), np.zeros((len(t_s), 3))

    return breathing, recorded_breathing(breathing, still, until_s, rng)["respiration"]


def follow(spec: BreathSpec, until_s: float, seed: int, late_s: float = 0.0, log: Log = no_log) -> Followed:
    """Follow a breath that a channel records; beats are measured from FIRST_BEAT_S on."""
    breathing, recorded = breathing_world(spec, until_s, seed)
    recorded = Respiration(recorded.t_s + late_s, recorded.values, recorded.name)
    tracker, rng = BreathingTracker(CENTER, log), np.random.default_rng([seed, 1])
    pushed, next_beat_s, seen = 0, FIRST_BEAT_S, []
    for now_s in np.arange(0.5, until_s, 0.1).tolist():
        due = int(np.searchsorted(recorded.t_s, now_s, side="right"))
        for k in range(pushed, due):
            tracker.push(RespirationSample(float(recorded.t_s[k]), recorded.values[k]))
        pushed = due
        tracker.advance(now_s)
        if now_s > next_beat_s + 1.0:
            add_beat(tracker, breathing, next_beat_s + np.arange(10) / 12.0, rng)
            next_beat_s += 0.85
        pose = tracker.motion(RESTING, now_s).at(now_s + 0.01) @ RESTING.end.inverse()
        moved = pose.apply_array(breathing.points_at(GRID, np.array([now_s + 0.01]))[0])
        seen.append((now_s, _mean_distance_mm(moved), tracker.withheld(now_s)))
    return _followed(seen, tracker)


def follow_by_ecg(
    spec: BreathSpec, until_s: float, seed: int, rhythm: RhythmSpec = SINUS, log: Log = no_log
) -> Followed:
    """Follow a breath, or a heart without one, that the ECG alone shows; beats are measured from 10 s on."""
    rng = np.random.default_rng(seed)
    breaths = draw_breaths(spec, until_s, rng)
    breathing = breathing_of(spec, breaths, CENTER, rng)
    beats = beat_series(rhythm, 0.0, until_s, rng, breaths.volume_at)
    ecg = synthetic_ecg(beats, until_s, EcgSpec(), rng, breaths.volume_at)
    tracker = BreathingTracker(CENTER, log, ecg.rate_hz)
    tracker.push_ecg(EcgSamples(0.0, ecg.samples))
    peaks, seen = deque(detect_r_peaks(ecg)), []
    begin_s = peaks[0].t_s
    for now_s in np.arange(0.5, until_s - 1.0, 0.1).tolist():
        while peaks and peaks[0].detected_at_s <= now_s:
            peak = peaks.popleft()
            tracker.add_peak(peak)
            if peak.t_s > 10.0:
                add_beat(tracker, breathing, np.arange(begin_s, peak.t_s, 1.0 / 12.0), rng)
            begin_s = peak.t_s
        tracker.advance(now_s)
        moved = GRID if breathing is None else breathing.points_at(GRID, np.array([now_s]))[0]
        seen.append((now_s, _mean_distance_mm(moved), tracker.withheld(now_s)))
    return _followed(seen, tracker)


def add_beat(
    tracker: BreathingTracker, breathing: Breathing | None, t_s: FloatArray, rng: np.random.Generator
) -> None:
    """Measure the frames of a beat, with noise; what the tracker knew of the breath is taken out of it."""
    shown = np.zeros(6) if breathing is None else true_xi_mm(breathing, t_s).mean(axis=0)
    shown = shown + NOISE_MM * rng.standard_normal(6)
    frames = tracker.frames(t_s)
    if frames is None:
        tracker.watch(float(t_s[0]) + 0.4, float(t_s[0]) + 1.1, measured(shown), STILL_VIEW_MM)
    else:
        tracker.add_beat(measured(shown - frames.xi_mm.mean(axis=0)), frames)


def measured(xi_mm: FloatArray) -> BeatMeasurement:
    """Make the measurement of a beat whose heart lies `xi_mm` from RESTING."""
    information = np.eye(6) / NOISE_MM**2
    moved_mm = float(np.linalg.norm(xi_mm))
    pose = RESTING.end
    return BeatMeasurement(
        pose, pose, information @ xi_mm, information, 0.6, 0.6, 0.0, 10.0, moved_mm, 1.0, 1
    )


def true_xi_mm(breathing: Breathing, t_s: FloatArray) -> FloatArray:
    """ξ, (n, 6), that takes the breathing heart to its rest."""
    turn, shift = breathing.mr_from_rest(t_s)
    back = np.swapaxes(turn, 1, 2)
    turns = HEART_RADIUS_MM * Rotation.from_matrix(back).as_rotvec()
    return np.hstack([turns, -np.einsum("nij,nj->ni", back, shift)])


def _mean_distance_mm(points: FloatArray) -> float:
    return float(np.linalg.norm(points - GRID, axis=1).mean())


def _followed(seen: Sequence[tuple[float, float, bool]], tracker: BreathingTracker) -> Followed:
    t_s, error_mm, withheld = zip(*seen, strict=True)
    return Followed(np.array(t_s), np.array(error_mm), np.array(withheld), tracker)


def breathing_trial(settings: Settings, number: int) -> Line:
    """Follow one recording.

    Args:
        settings: `seconds`.
        number: of seed and way, those of one seed one after the other.
    """
    seed, place = divmod(number, len(WAYS))
    name, way = list(WAYS.items())[place]
    until_s, records = settings["seconds"], list[BreathingRecord]()
    if way.recorded:
        course = follow(way.spec, until_s, seed, way.late_s, records.append)
    else:
        course = follow_by_ecg(way.spec, until_s, seed, way.rhythm, records.append)
    served = ~course.withheld & (course.t_s > LEARNT_S)
    errors_mm = course.error_mm[served]
    latencies = [record.latency_s for record in records if record.latency_s is not None]
    line: dict[str, Any] = {
        "way": name,
        "world_seed": seed,
        "served": float(served.sum() / (course.t_s > LEARNT_S).sum()),
        "median_mm": float(np.median(errors_mm)) if served.any() else None,
        "p95_mm": float(np.percentile(errors_mm, 95)) if served.any() else None,
        "largest_mm": float(errors_mm.max()) if served.any() else None,
        "latency_s": latencies[-1] if latencies else None,
        "breathing_found": any(record.unfollowed_mm is not None for record in records),
    }
    return line | (_event(course, way, until_s, seed) if way.spec.events else {})


def _event(course: Followed, way: Way, until_s: float, seed: int) -> Line:
    """How soon the pose was withheld at an event, and how soon it came back."""
    breaths = draw_breaths(way.spec, until_s, np.random.default_rng(seed))
    beyond = (breaths.volume < -0.05) | (breaths.volume > BEYOND_VOLUME)
    times = breaths.t_s[beyond & (breaths.t_s > EVENT_S)]
    if not len(times):
        return {}
    begin_s, end_s = float(times[0]), float(times[-1])
    after = (course.t_s > begin_s) & course.withheld
    line: Line = {"withheld_s": float(course.t_s[after][0]) - begin_s if after.any() else None}
    if way.spec.events[0][0] in PERMANENT:
        return line
    again = (course.t_s > end_s) & ~course.withheld
    breath_s = 60.0 / way.spec.per_minute
    return line | {"back_breaths": float(course.t_s[again][0] - end_s) / breath_s if again.any() else None}


def run(settings: BreathingSettings, driver: Driver) -> Result:
    """Follow every way on every seed."""
    fields = {"seconds": settings.seconds, "ways": list(WAYS)}
    numbers = range(settings.seed * len(WAYS), (settings.seed + settings.seeds) * len(WAYS))
    lines = driver.trials(Trials("breathing", fields, breathing_trial), numbers, group_size=len(WAYS))
    summary = {**fields, "seed": settings.seed, "seeds": settings.seeds, "rows": lines}
    return Result(summary, _table(lines), {"summary.json": summary})


def _table(lines: Sequence[Line]) -> Rows:
    head = (
        *("breath", "seeds", "served %", "median mm", "p95 mm", "largest mm"),
        *("withheld s", "back after breaths", "latency s", "found"),
    )
    return [head, *(_row(name, [line for line in lines if line["way"] == name]) for name in WAYS)]


def _row(name: str, lines: Sequence[Line]) -> tuple[str, ...]:
    """Medians over the seeds, of the last of the errors and of the times the largest."""

    def over(key: str, form: str, of: Callable[[FloatArray], Any]) -> str:
        values = [line[key] for line in lines if line.get(key) is not None]
        return format(float(of(np.array(values))), form) if values else ""

    return (
        name,
        str(len(lines)),
        over("served", ".0%", np.median).rstrip("%"),
        over("median_mm", ".2f", np.median),
        over("p95_mm", ".2f", np.median),
        over("largest_mm", ".1f", np.max),
        over("withheld_s", ".2f", np.max),
        over("back_breaths", ".1f", np.max),
        over("latency_s", ".2f", np.median),
        f"{sum(line['breathing_found'] for line in lines)} of {len(lines)}",
    )


STUDY = Study(BreathingSettings, run)
