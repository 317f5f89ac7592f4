"""The replay on one screen: a recording's events through a session, a state every millisecond.

    pre-op   build the distance model and the registration channels           Sections III, VI
    before   calibrate tool tip, probe image and latency                      calibration
    live     push every event in order of time, ask for the state             session, Sections VI, VII

The ground truth is not read here; `score` does that with what this returns.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import RetimeMode
from dvf_ig.core import DvfModel, FloatArray, Progress, Rigid, Scenario, untold
from dvf_ig.core.summary import Rows, summary_html, summary_text
from dvf_ig.guidance import FORBIDDEN_SURFACE, WITHHOLDING, FixtureSet, SupervisorState
from dvf_ig.guidance.servo.inputs import VALID_FOR_S
from dvf_ig.intake.calibrations import Calibrations, calibrate, calibrated
from dvf_ig.intake.findings import Finding
from dvf_ig.intake.fit import fit_of
from dvf_ig.intake.live_record import LiveRecord
from dvf_ig.intake.parts import SessionFiles
from dvf_ig.intake.start import landmarks_start, require_start, start_pose, touched_points
from dvf_ig.session import (
    GuidanceState,
    Heart,
    Rearm,
    RegistrationRecord,
    Session,
    SessionHistory,
    SessionSetup,
    beat_source_of,
    build_heart,
)

from .events import events_of
from .preconditions import require_heart_beats, require_tracked_poses, tick_times
from .repetition import AsRecorded, repeat
from .ticks import TickRecorder, Ticks

REARM_AFTER_S = 1.0
"""A recording holds no operator. This one waits so long after the hazards have gone, and between requests."""


@dataclass(slots=True)
class SimulatedOperator:
    """Watches the state and asks for force again."""

    _clear_since_s: float | None = None

    def action(self, state: GuidanceState) -> Rearm | None:
        """Choose the action of the operator now."""
        if state.supervisor is not SupervisorState.LATCHED or state.supervised.hazards & WITHHOLDING:
            self._clear_since_s = None
            return None
        if self._clear_since_s is None:
            self._clear_since_s = state.now_s
        if state.now_s - self._clear_since_s < REARM_AFTER_S:
            return None
        self._clear_since_s = state.now_s
        return Rearm(state.now_s)


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

    def __repr__(self) -> str:
        return summary_text("Replay", self._rows)

    def _repr_html_(self) -> str:
        return summary_html("Replay", self._rows)

    @property
    def _rows(self) -> Rows:
        ticks, usable = self.ticks, sum(attempt.usable for attempt in self.attempts)
        force_n = np.linalg.norm(ticks.force_n[ticks.valid], axis=1)
        return [
            ("scenario", self.scenario.name),
            ("registrations", f"{usable} of {len(self.attempts)} usable"),
            ("pose in use", f"from {self.poses[0][0]:.1f} s" if self.poses else "never"),
            ("ticks", f"{len(ticks)}, {ticks.valid.mean():.0%} valid"),
            ("force", f"{force_n.max(initial=0.0):.2f} N at most"),
            ("computing", f"{self.seconds:.1f} s"),
        ]

    @property
    def heart(self) -> Heart:
        return self.setup.heart

    @property
    def attempts(self) -> tuple[RegistrationRecord, ...]:
        return self.history.registrations

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
    live: LiveRecord | None = None,
) -> Replay:
    """Replay a scenario from raw streams to force.

    Args:
        model: this patient's fixture model, if it was built before; else it is built here.
        fixtures: that act on the tool.
        retiming: how the beat is mapped to the model's cycle.
        seed: of the random choices in calibration and registration.
        clock: times the computing; no estimate depends on it.
        live: of the record of a live session, which is repeated as it was: in the order in which things came,
            with the states and re-armings that there were, and with its own seed.
    Raises:
        InvalidInputError: a recording cannot be used (no heart beats, no tracked pose, …).
        QualityGateError: a calibration refused its recording.
    """
    report_progress = progress or untold
    began = clock()
    require_start(scenario)
    if live is None:
        require_tracked_poses(scenario)
    else:
        seed = live.seed
    t_s = tick_times(scenario) if live is None else live.last_states[:, 0]
    calibrations = calibrate(scenario, seed)
    report_progress(0.05)
    heart = build_heart(scenario.preop, model, progress=lambda f: report_progress(0.05 + 0.35 * f))
    start = start_pose(scenario, heart, seed)
    findings = _findings(calibrated(scenario, calibrations), heart.model)
    setup = SessionSetup(
        heart,
        calibrations.in_use,
        beat_source_of(scenario.ecg),
        start=None if landmarks_start(scenario) else start,
        touched=touched_points(scenario, heart.model),
        fan=scenario.fan,
        fixtures=fixtures,
        retiming=retiming,
        seed=seed,
    )
    history, recorder = SessionHistory(), TickRecorder(t_s)
    session_began = clock()

    def observe(i: int, state: GuidanceState) -> None:
        recorder.add(i, state)
        if i % REPORT_EVERY == 0:
            report_progress(0.4 + 0.6 * i / len(t_s))

    executor = None if live is None else AsRecorded(live.refused)
    latch_after_s = inf if live is None else VALID_FOR_S
    with Session(
        setup, executor=executor, clock=clock, history=history, latch_after_s=latch_after_s
    ) as session:
        if live is None:
            _run(session, scenario, t_s, observe)
        else:
            repeat(session, live, observe)
    if live is None:
        require_heart_beats(history.peaks, scenario)
    else:
        findings = (*live.findings, *findings)
    ticks, ended = recorder.finish(), clock()
    whole_s, session_s = ended - began, ended - session_began
    return Replay(scenario, setup, calibrations, start, history, ticks, findings, whole_s, session_s)


def _run(
    session: Session, scenario: Scenario, t_s: FloatArray, observe: Callable[[int, GuidanceState], None]
) -> None:
    """Every event at its stamp, a state at every tick, and an operator who re-arms."""
    events, operator = events_of(scenario), SimulatedOperator()
    upcoming = next(events)
    for i, now_s in enumerate(t_s.tolist()):
        while upcoming[0] <= now_s:
            session.push(upcoming[1])
            upcoming = next(events, (np.inf, upcoming[1]))
        state = session.state(now_s)
        observe(i, state)
        action = operator.action(state)
        if action is not None:
            session.push(action)


def _findings(scenario: Scenario, model: DvfModel) -> tuple[Finding, ...]:
    return fit_of(SessionFiles.of(scenario, model)).findings
