"""The replay on one screen: a recording's events through a session, a state every millisecond.

    pre-op   build the distance model and the registration channels           Sections III, VI
    before   calibrate tool tip, probe image and latency                      calibration
    live     push every event in order of time, ask for the state             session, Sections VI, VII

The ground truth is not read here; `score` does that with what this returns.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import RetimeMode
from dvf_ig.core import DvfModel, Progress, Rigid, Scenario, untold
from dvf_ig.guidance import FORBIDDEN_SURFACE, FixtureSet
from dvf_ig.io import SessionRecordings
from dvf_ig.io.session_file.agreement.finding import Finding
from dvf_ig.io.session_file.fit import fit_of, parts_of
from dvf_ig.session import (
    Attempt,
    Heart,
    Session,
    SessionHistory,
    SessionSetup,
    beat_source_of,
    build_heart,
)

from .calibrations import Calibrations, calibrate, calibrated
from .events import ECG_CHUNK, events_of
from .operator import SimulatedOperator
from .preconditions import require_heart_beats, require_tracked_poses, tick_times
from .start import (
    landmarks_start,
    require_start,
    start_pose,
)
from .ticks import TickRecorder, Ticks

Clock = Callable[[], float]
"""Seconds of computing time, from any origin."""
REPORT_EVERY = 500
"""Ticks between two reports of progress."""


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """Everything a replay estimated.

    Attributes:
        setup: patient, calibrations and fixtures of the session.
        calibrations: with their evidence.
        start: coarse mr_from_tracker that registration started from.
        history: R peaks, registrations, evaluated beats and what they did to the pose.
        ticks: what the session said every millisecond.
        findings: in what the recordings disagree, which the session has to find out for itself.
        seconds: computing time of the whole; `session_seconds` of the session, with pushing and recording.
    """

    scenario: Scenario
    setup: SessionSetup
    calibrations: Calibrations
    start: Rigid
    history: SessionHistory
    ticks: Ticks
    findings: tuple[Finding, ...]
    seconds: float
    session_seconds: float

    @property
    def heart(self) -> Heart:
        return self.setup.heart

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        return tuple(self.history.attempts)

    @property
    def poses(self) -> tuple[tuple[float, Rigid], ...]:
        """(time from which it was in use, mr_from_tracker), without suspensions."""
        return tuple((u.from_s, u.pose) for u in self.history.updates if u.pose is not None)


def run_replay(
    scenario: Scenario,
    *,
    model: DvfModel | None = None,
    fixtures: FixtureSet = FORBIDDEN_SURFACE,
    retiming: RetimeMode = "two-segment",
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = perf_counter,
    ecg_chunk: int = ECG_CHUNK,
) -> Replay:
    """Replay a scenario from raw streams to force.

    Args:
        model: this patient's fixture model, where it was built before; else it is built here.
        fixtures: that act on the tool.
        retiming: how the beat is mapped to the model's cycle.
        seed: of the random choices in calibration and registration.
        clock: times the computing; no estimate depends on it.
        ecg_chunk: ECG samples that are pushed at once; no estimate depends on it.
    Raises:
        InvalidInputError: a recording cannot be used (no heart beats, no tracked pose, …).
        QualityGateError: a calibration refused its recording.
    """
    report_progress = progress or untold
    began = clock()
    require_start(scenario)
    require_tracked_poses(scenario)
    t_s = tick_times(scenario)
    calibrations = calibrate(scenario, seed)
    in_use = calibrations.in_use
    report_progress(0.05)
    heart = build_heart(scenario.preop, model, progress=lambda f: report_progress(0.05 + 0.35 * f))
    start = start_pose(scenario, heart, seed)
    findings = _findings(calibrated(scenario, calibrations), heart.model)
    setup = SessionSetup(
        heart,
        in_use,
        beat_source_of(scenario.ecg),
        start=None if landmarks_start(scenario) else start,
        fan=scenario.fan,
        fixtures=fixtures,
        retiming=retiming,
        seed=seed,
    )
    history, recorder, operator = SessionHistory(), TickRecorder(t_s), SimulatedOperator()
    events = events_of(scenario, ecg_chunk=ecg_chunk)
    upcoming, session_began = next(events), clock()
    with Session(setup, clock=clock, history=history) as session:
        for i, now_s in enumerate(t_s.tolist()):
            while upcoming[0] <= now_s:
                session.push(upcoming[1])
                upcoming = next(events, (np.inf, upcoming[1]))
            state = session.state(now_s)
            recorder.add(i, state)
            action = operator.action(state)
            if action is not None:
                session.push(action)
            if i % REPORT_EVERY == 0:
                report_progress(0.4 + 0.6 * i / len(t_s))
    require_heart_beats(history.peaks, scenario)
    ticks, ended = recorder.finish(), clock()
    whole_s, session_s = ended - began, ended - session_began
    return Replay(scenario, setup, calibrations, start, history, ticks, findings, whole_s, session_s)


def _findings(scenario: Scenario, model: DvfModel) -> tuple[Finding, ...]:
    return fit_of(parts_of(SessionRecordings(scenario, model, None, None))).findings
