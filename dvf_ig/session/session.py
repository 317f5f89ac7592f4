"""One engine for the operating room and the replay: events in, inputs of the servo and its force out.

    ECG      R peaks ─► phase φ, its σ and state ─► T_d, retiming          clocks
    breath   ρ, its state ─► frames at rest, motion of the heart           breathing
    frames   gate ─► register, compare every beat ─► pose and its age      arrived_ultrasound, pose_tracker
    tool     newest pose ─► predicted tip                                  tool_tracker
             tip where frames should show it ─► evidence on calibrations   tip_watch
    force    pose, phase, hazards, margins ─► the servo's tick             guidance.servo

A session is pushed events and asked for its state at moments in order. It knows no file, no network and no
wall clock. An event counts from its stamp on: a state depends on nothing that is stamped later, so the same
events give the same bits however they are cut into pieces or interleaved, as long as each is there when a
state at or after its stamp is asked for; one that comes later counts from then on.
"""

from bisect import insort
from collections.abc import Callable
from dataclasses import replace
from math import hypot, inf, nan
from operator import attrgetter
from types import TracebackType

from dvf_ig.cardiac import retiming_curve
from dvf_ig.core import InvalidInputError, PhaseState
from dvf_ig.guidance import Fixtures, Hazard, PoseAndPhase, RearmAnswer, Status
from dvf_ig.guidance.servo import TrackedServo
from dvf_ig.registration import SliceThreads

from .arrived_ultrasound import ArrivedUltrasound, FrameBuffer
from .breathing import BreathingStatus, BreathingTracker
from .clocks import HeartClock, SourceClocks
from .events import EcgSamples, Event, Landmark, Rearm, RespirationSample, ToolPose, TrackedFrame, Trigger
from .history import SessionHistory
from .margins import MarginTracker
from .pose_tracker import PoseTracker
from .setup import EcgSource, SessionSetup
from .state import GuidanceState
from .tip_watch import TipWatch
from .tool_tracker import ToolTracker
from .work import Executor, InlineExecutor, UltrasoundSource

REMEMBERED = 200
"""Registrations, beats and updates that a session remembers unless it is given a history of its own."""


def _no_clock() -> float:
    return 0.0


class Session:
    """Turns events into the state of guidance; a context manager that owns its threads.

    Args:
        setup: patient, calibrations and fixtures.
        executor: does the long work; by default the caller does, when its result is due.
        clock: seconds of computing time from any origin, for the record; no estimate depends on it.
        history: log of registrations, beats and updates; by default of the last REMEMBERED.
        latch_after_s: see `TrackedServo`; VALID_FOR_S in a live session.
        ultrasound: makes the source of registrations and compared beats from the buffer of arriving frames;
            by default their images are used.
    """

    def __init__(
        self,
        setup: SessionSetup,
        *,
        executor: Executor | None = None,
        clock: Callable[[], float] = _no_clock,
        history: SessionHistory | None = None,
        latch_after_s: float = inf,
        ultrasound: Callable[[FrameBuffer], UltrasoundSource] | None = None,
    ) -> None:
        self.setup = setup
        self.history = history if history is not None else SessionHistory(REMEMBERED)
        self._threads = SliceThreads()
        self._frames = FrameBuffer()
        ecg_hz = setup.beat_source.rate_hz if isinstance(setup.beat_source, EcgSource) else None
        self._breathing = BreathingTracker(setup.heart.center_mm, self.history.append, ecg_hz)
        if ultrasound is None:
            source = self._arrived(clock, executor if executor is not None else InlineExecutor())
        else:
            source = ultrasound(self._frames)
        lag_s = setup.calibrations.lag_s
        self._pose = PoseTracker(source, setup.start, self.history, lag_s, self._breathing, setup.touched)
        self._clock = HeartClock(setup.beat_source)
        self._sources = SourceClocks(setup.beat_source)
        self._tool = ToolTracker(setup.calibrations.tip)
        self._orders = (self._frames.order, self._clock.order, self._breathing.order, self._tool.order)
        self._tip = TipWatch(self._frames, setup.calibrations, setup.fan)
        fixtures = Fixtures(setup.heart.model, setup.fixtures)
        self._shape = setup.fixtures.tool
        self._servo = TrackedServo(fixtures, limits=setup.device, latch_after_s=latch_after_s)
        self._margins = MarginTracker(fixtures, setup.device)
        self._actions: list[Landmark | Rearm] = []
        self._known: tuple[object, object, object, float] = (None, None, None, -inf)
        self._rearmed: RearmAnswer | None = None
        self._now_s = -inf

    def __enter__(self) -> "Session":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._threads.__exit__(kind, error, trace)

    def push(self, event: Event, arrived_s: float | None = None) -> bool:
        """Add an event; those of one kind in the order of their arrival.

        Args:
            arrived_s: time of its arrival on the clock of `state`; with it a source's clock that runs away is
                noticed and corrected (`clocks`). None for a recording, which has no arrivals.
        Returns:
            whether it is used: False if its stamp is not later than those before, or its clock went back.
        Raises:
            InvalidInputError: it does not fit those before (another number of leads, another image size) or
                the session's source of beats.
        """
        if arrived_s is not None:
            accepted = self._sources.on_local_clock(event, arrived_s)
            if accepted is None:
                return False
            event = accepted
        if isinstance(event, EcgSamples | Trigger):
            used = self._clock.push(event)
            if used and isinstance(event, EcgSamples):
                self._breathing.push_ecg(event)
            return used
        if isinstance(event, RespirationSample):
            return self._breathing.push(event)
        if isinstance(event, ToolPose):
            if not event.by_encoders:
                self._tip.push(event)
            return self._tool.push(event)
        if isinstance(event, TrackedFrame):
            first, used = not self._frames.any, self._frames.push(event)
            if used and first:
                self._pose.begin(event.t_s + self.setup.calibrations.lag_s)
            return used
        insort(self._actions, event, key=attrgetter("t_s"))
        return True

    def clock_correction_s(self, kind: type[Event]) -> float:
        """Return the correction that is added to the stamps of a kind of event."""
        return self._sources.correction_s(kind)

    def state(self, now_s: float) -> GuidanceState:
        """Return the state at `now_s`, with the force to send then; the servo ticks until then.

        Raises:
            InvalidInputError: `now_s` lies before an earlier one or is not finite.
        """
        if not (now_s >= self._now_s and now_s < inf):
            raise InvalidInputError(
                f"the state at {now_s:g} s was asked for after that at {self._now_s:g} s; "
                "ask in order of time"
            )
        stepped_s, self._now_s = self._now_s, now_s
        self._advance(now_s, stepped_s)
        self._frames.advance(now_s)
        self._tip.advance(now_s)
        self._clock.order.advance(now_s)
        breathing = self._breathing.status(now_s)
        self._update_transform(now_s, breathing)
        tool = self._tool.at(now_s)
        # an unknown tool has no position in a pose; a missing pose is reported first
        posed = self._transform.pose is not None and now_s < self._transform.pose_until_s
        tool_status = Status.STALE_TOOL if posed and tool.hazard else Status.OK
        hazards, margin_mm = self._hazards(now_s, tool.hazard, breathing), self._margins.margin_mm
        tip = None if tool.hazard else (tool.tip_tracker_mm, tool.velocity_mm_s)
        axis = None if tool.hazard else self._shape.axis_in_tracker(tool.rotation)
        tick = self._servo.step(now_s, self._transform, hazards, tool_status, margin_mm, tip, axis)
        confirmation = self._pose.confirmation
        age_s = inf if confirmation is None else now_s - confirmation.confirmed_s
        if self._margins.due(now_s):
            self._margins.update(now_s, tick, self._transform, tool.tip_tracker_mm, age_s)
        return GuidanceState(
            now_s=now_s,
            transform=self._transform,
            estimate=self._pose.estimate,
            pose_age_s=age_s,
            pose_bound_mm=nan
            if confirmation is None
            else hypot(confirmation.bound_mm(now_s), breathing.bound_mm),
            doubt=self._pose.doubt,
            breathing=breathing.reason,
            breath=breathing.breath,
            tip_seen=self._tip.seen,
            registration=self.history.last_registration,
            model_phase=self._servo.model_phase,
            tool=tool,
            calibrations=self.setup.calibrations,
            hazards=hazards,
            tool_status=tool_status,
            margin_mm=margin_mm,
            tick=tick,
            rearmed=self._rearmed,
        )

    def _advance(self, now_s: float, stepped_s: float) -> None:
        """Take everything that happens until now, in order of time."""
        while True:
            action_s = self._actions[0].t_s if self._actions else inf
            input_s, pose_s = min(self._clock.next_s, action_s), self._pose.next_s
            if input_s > now_s and pose_s > now_s:
                self._follow_breath(now_s)
                return
            self._follow_breath(min(input_s, pose_s))
            if input_s > pose_s:
                self._pose.step()
            elif action_s == input_s:
                self._act(self._actions.pop(0), stepped_s)
            else:
                self._take_peak(stepped_s)

    def _follow_breath(self, now_s: float) -> None:
        if self._breathing.advance(now_s):
            self._pose.renew(now_s)

    def _act(self, action: Landmark | Rearm, stepped_s: float) -> None:
        if isinstance(action, Landmark):
            self._pose.add_landmark(action)
        else:
            self._rearmed = self._servo.rearm(max(action.t_s, stepped_s))

    def _take_peak(self, stepped_s: float) -> None:
        """Take the next R peak; one whose samples came late counts from now on, never in the past."""
        peak = self._clock.step()
        if peak is not None:
            peak = replace(peak, detected_at_s=max(peak.detected_at_s, stepped_s))
            self.history.append(peak)
            if self._breathing.add_peak(peak):
                self._pose.follow_breath(peak.detected_at_s)
            self._pose.add_peak(peak)
            seen = self._tip.after_beat(peak.t_s, peak.detected_at_s)
            if seen is not None:
                self._pose.add_tip(seen, peak.detected_at_s)

    def _update_transform(self, now_s: float, breathing: BreathingStatus) -> None:
        """Publish a new value if the pose, its confirmation or the phase's forecast has changed."""
        phase, motion = self._clock.forecast(now_s), self._pose.motion
        confirmation, breath_s = self._pose.confirmation, breathing.changed_s
        phase_before, motion_before, confirmation_before, breath_before_s = self._known
        if (
            phase is phase_before
            and motion is motion_before
            and confirmation is confirmation_before
            and breath_s == breath_before_s
        ):
            return
        self._known = (phase, motion, confirmation, breath_s)
        if motion is not None:
            motion = self._breathing.motion(motion, now_s)
        heart, covariance = self.setup.heart, self._pose.covariance_mm2(now_s)
        model = heart.model
        self._transform = PoseAndPhase(
            pose=motion,
            phase=phase,
            retiming=retiming_curve(phase.rr_s, model.timing.rr_s, model.es_fraction, self.setup.retiming)
            if phase.rr_s > 0
            else None,
            covariance_mm2=None if covariance is None else covariance + breathing.covariance_mm2,
            center_mm=heart.center_mm,
            pose_until_s=-inf if confirmation is None or breathing.withheld else confirmation.until_s,
            warp=self._pose.warp,
        )

    def _hazards(self, now_s: float, tool: Hazard, breathing: BreathingStatus) -> Hazard:
        """List the hazards of pose, phase, tracking and time at this moment."""
        hazards, transform = tool, self._transform
        if self._pose.estimate is None:
            hazards |= Hazard.NO_POSE
        elif transform.pose is None:
            hazards |= Hazard.POSE_CONTRADICTED
        elif breathing.withheld:
            hazards |= Hazard.BREATHING
        elif now_s >= transform.pose_until_s:
            hazards |= Hazard.POSE_UNCONFIRMED
        elif self._pose.motion is not None and now_s < self._pose.motion.end_s:
            hazards |= Hazard.POSE_MOVING
        if transform.phase.state is not PhaseState.LOCKED or now_s > transform.phase.until_s:
            hazards |= Hazard.NO_PHASE
        frames, beats, breaths, tools = self._orders
        if frames.restarted or beats.restarted or breaths.restarted or self._sources.behind:
            hazards |= Hazard.CLOCK_BACKWARDS
        if frames.disordered or beats.disordered or breaths.disordered or tools.disordered:
            hazards |= Hazard.REORDERED_STAMPS
        if self._sources.skewed:
            hazards |= Hazard.CLOCK_SKEW
        return hazards

    def _arrived(self, clock: Callable[[], float], executor: Executor) -> UltrasoundSource:
        setup = self.setup
        return ArrivedUltrasound(
            self._frames,
            setup.heart,
            setup.calibrations,
            setup.fan,
            setup.retiming,
            setup.seed,
            clock,
            self._threads,
            executor,
            self._breathing,
        )
