"""A whole session on one core: time of a state and of a beat's update, and whether its memory grows."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_synth import ScenarioSpec, phantom_scenario
from dvf_ig.core import DvfModel, FloatArray, InvalidInputError, Scenario
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.replay.operator import SimulatedOperator
from dvf_ig.session import InCaller, Session, SessionSetup, beat_source_of, build_heart

from .endless import Round
from .timing import Row, row

RECORDED_S = 30.0
STATES_PER_S = 1000
WARM_UP_SHARE, WARM_UP_S = 0.1, 60.0
"""Memory is compared with that after this share of the time, but no longer than WARM_UP_S."""
MEMORY_OVER_S = 15
"""Resident memory is the median over so many seconds: more than from one registration to the next."""
SHORTEST_S = 15.0


@dataclass(frozen=True, slots=True)
class SessionBench:
    """What `dvf-ig bench --session` measured.

    Attributes:
        rows: a state; a beat's update, preparation included.
        seconds: simulated; `computing_s` processor time of session and operator, without making the streams.
        resident_mb_start, resident_mb_end: after the warm-up and at the end; None where not known.
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
        """Of resident memory after the warm-up."""
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
        model: of this patient, where it was built before.
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
    setup: SessionSetup,
    recorded: Round,
    seconds: float,
    progress: Callable[[float], None] | None = None,
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
    with Session(setup, executor=InCaller(), clock=time.process_time) as session:
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
        registrations=len(history.attempts),
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
