"""A whole session on one core: time of a state and of a beat's update, and whether its memory grows.

A recorded intervention runs without an end: its streams round after round, with later stamps in each.
"""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np

from data_synth import ScenarioSpec, phantom_scenario
from dvf_ig.cardiac import stream_recording
from dvf_ig.core import DvfModel, FloatArray, InvalidInputError, Scenario, TriggerTimes, read_only_arrays
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.replay.engine import SimulatedOperator
from dvf_ig.replay.events import ECG_CHUNK, Timed, events_of
from dvf_ig.session import EcgSamples, InlineExecutor, Session, ToolPose, TrackedFrame, build_heart
from dvf_ig.session.setup import SessionSetup, beat_source_of

from .timing import Row, row

MIN_BEATS = 10
"""Fewest R peaks of a recording that is repeated."""
OUT_OF_SIGHT_S = 0.3
"""Probe and tool are out of the tracker's sight so long before each round's end: they jump at the seam."""
AFTER_R = 0.5
"""A round begins and ends at this share of a beat, where no wave of the ECG is cut."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One round.

    Attributes:
        begin_s, seconds: of the recording's clock; a whole number of ECG samples.
        ecg: (n, leads) its samples; rate_hz: of these.
        tracked: its frames and tool poses, with their stamps.
    """

    begin_s: float
    seconds: float
    ecg: FloatArray
    rate_hz: float
    tracked: tuple[Timed, ...]

    def events(self) -> Iterator[Timed]:
        """Events without an end, in order of time; the ECG first where stamps are equal."""
        for k in count():
            shift_s = k * self.seconds
            yield from sorted((*self._ecg(k), *self._moved(shift_s)), key=lambda timed: timed[0])

    def _ecg(self, k: int) -> Iterator[Timed]:
        """Stamps follow from the number of the sample alone, so that no rounding adds up."""
        for first in range(0, len(self.ecg), ECG_CHUNK):
            start_s = self.begin_s + (k * len(self.ecg) + first) / self.rate_hz
            yield start_s, EcgSamples(start_s, self.ecg[first : first + ECG_CHUNK])

    def _moved(self, shift_s: float) -> Iterator[Timed]:
        for t_s, event in self.tracked:
            if isinstance(event, ToolPose | TrackedFrame):
                yield t_s + shift_s, replace(event, t_s=t_s + shift_s)


def round_of(scenario: Scenario) -> Round:
    """From the middle of one early beat to the middle of a late one, so that the rhythm goes on at the seam.

    Raises:
        InvalidInputError: too few heart beats.
    """
    ecg = scenario.ecg
    if isinstance(ecg, TriggerTimes):
        raise InvalidInputError("the scenario has a trigger in place of an ECG; take one with an ECG")
    peaks, _ = stream_recording(ecg)
    if len(peaks) < MIN_BEATS:
        raise InvalidInputError(f"the ECG has {len(peaks)} R peaks; needed at least {MIN_BEATS} to repeat it")
    first, last = (
        round((before.t_s + AFTER_R * (after.t_s - before.t_s) - ecg.start_s) * ecg.rate_hz)
        for before, after in (peaks[1:3], peaks[-2:])
    )
    begin_s, seconds = ecg.start_s + first / ecg.rate_hz, (last - first) / ecg.rate_hz
    hidden_s = begin_s + seconds - OUT_OF_SIGHT_S
    tracked = tuple(
        (t_s, _out_of_sight(event) if t_s >= hidden_s else event)
        for t_s, event in events_of(scenario)
        if isinstance(event, ToolPose | TrackedFrame) and begin_s <= t_s < begin_s + seconds
    )
    return Round(begin_s, seconds, ecg.samples[first:last], ecg.rate_hz, tracked)


def _out_of_sight(event: ToolPose | TrackedFrame) -> ToolPose | TrackedFrame:
    if isinstance(event, ToolPose):
        return ToolPose(event.t_s, None)
    return TrackedFrame(event.t_s, event.image, None)


RECORDED_S = 30.0
STATES_PER_S = 1000
WARM_UP_SHARE, WARM_UP_S = 0.1, 60.0
"""Memory is compared with that after this share of the time, but no longer than WARM_UP_S."""
MEMORY_OVER_S = 15
"""Resident memory is the median over so many seconds: more than from one registration to the next."""
SHORTEST_S = 15.0


@dataclass(frozen=True, slots=True)
class SessionBench:
    """Result of `dvf-ig bench --session`.

    Attributes:
        rows: a state; a beat's update, preparation included.
        seconds: simulated; `computing_s` processor time of session and operator, without making the streams.
        resident_mb_start, resident_mb_end: after the warm-up and at the end; None if not known.
        served_share: of the states, those with a force of the fixtures that may be used.
        registrations: that ended, of those remembered; `beats` that were compared, likewise.
    """

    rows: tuple[Row, ...]
    seconds: float
    computing_s: float
    resident_mb_start: float | None
    resident_mb_end: float | None
    served_share: float
    registrations: int
    beats: int

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds a second of computing."""
        return self.seconds / self.computing_s

    @property
    def growth_percent(self) -> float | None:
        """Growth of resident memory after the warm-up, %."""
        if self.resident_mb_start is None or self.resident_mb_end is None:
            return None
        return 100.0 * (self.resident_mb_end / self.resident_mb_start - 1.0)


def bench_scenario(seed: int, progress: Callable[[float], None] | None = None) -> Scenario:
    """Half a minute of a calm synthetic intervention."""
    return phantom_scenario(ScenarioSpec(seconds=RECORDED_S, seed=seed), progress)


def bench_setup(
    scenario: Scenario,
    seed: int,
    model: DvfModel | None = None,
    progress: Callable[[float], None] | None = None,
) -> SessionSetup:
    """A session's setup from the scenario's own recordings.

    Args:
        model: of this patient, if it was built before.
    """
    return SessionSetup(
        build_heart(scenario.preop, model, progress),
        calibrate(scenario, seed).in_use,
        beat_source_of(scenario.ecg),
        start=scenario.start,
        fan=scenario.fan,
        seed=seed,
    )


def run_session(
    setup: SessionSetup, recorded: Round, seconds: float, progress: Callable[[float], None] | None = None
) -> SessionBench:
    """Push a recording round after round through a session whose caller does all the work.

    The longest state holds a registration. At each seam the probe and the tool jump; they are out of sight
    for a moment before, so the force fades and comes back, and the ECG goes on in the rhythm.

    Raises:
        InvalidInputError: fewer seconds than a registration and its beats take.
    """
    if not seconds >= SHORTEST_S:
        raise InvalidInputError(f"{seconds:g} s of a session asked for; needed at least {SHORTEST_S:g} s")
    events, operator = recorded.events(), SimulatedOperator()
    spent_us = np.full(int(seconds) * STATES_PER_S, np.nan)  # held from the beginning on
    memory_mb, computing_s, served = np.full(int(seconds), np.nan), 0.0, 0
    upcoming = next(events)
    with Session(setup, executor=InlineExecutor(), clock=time.process_time) as session:
        for second in range(int(seconds)):
            last_s = recorded.begin_s + second + 1.0
            due = []
            while upcoming[0] <= last_s:
                due.append(upcoming)
                upcoming = next(events)
            due.append(upcoming)
            began, next_event = time.process_time(), 0
            for i in range(second * STATES_PER_S, (second + 1) * STATES_PER_S):
                now_s = recorded.begin_s + (i + 1) / STATES_PER_S
                while due[next_event][0] <= now_s:
                    session.push(due[next_event][1])
                    next_event += 1
                start_ns = time.perf_counter_ns()
                state = session.state(now_s)
                spent_us[i] = 1e-3 * (time.perf_counter_ns() - start_ns)
                served += state.status == 0
                action = operator.action(state)
                if action is not None:
                    session.push(action)
            computing_s += time.process_time() - began
            memory_mb[second] = resident_mb()
            if progress is not None:
                progress((second + 1) / int(seconds))
        history = session.history
    beats_us = np.array([1e6 * beat.seconds for beat in history.beats])
    if not len(beats_us):
        raise InvalidInputError("no heart beat was compared with a pose; the registrations failed")
    warm = int(min(WARM_UP_SHARE * seconds, WARM_UP_S))
    return SessionBench(
        rows=(
            row("dvf_ig", "session state", spent_us, None, note="all work in the caller"),
            row("dvf_ig", "session beat", beats_us, None, note="processor time, preparation included"),
        ),
        seconds=float(int(seconds)),
        computing_s=computing_s,
        resident_mb_start=_median(memory_mb[warm : warm + MEMORY_OVER_S]),
        resident_mb_end=_median(memory_mb[-MEMORY_OVER_S:]),
        served_share=served / len(spent_us),
        registrations=len(history.registrations),
        beats=len(history.beats),
    )


def resident_mb() -> float:
    """Resident memory of this process; NaN where the system does not tell."""
    file = Path("/proc/self/statm")
    if not file.exists():
        return float("nan")
    pages = int(file.read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _median(values: FloatArray) -> float | None:
    middle = float(np.median(values))
    return middle if np.isfinite(middle) else None
