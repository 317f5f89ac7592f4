"""The session's own thread on one screen: what arrived in, states and the servo's inputs, answers out.

    arrivals ─► events ─► Session.push        each with its arrival, so that clocks that run away are found
    now      ─► Session.state ─► servo        at every tool pose, and STATE_EVERY_S without one
    servo's newest tick ─► force, pose, state to the peers, at most ANSWERS_HZ

Nothing here waits for a peer, a registration or the servo. It begins with the first tool pose: before, no
tool is lost. However it ends, the last that it sends is no force, and why.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from dvf_ig.core import DvfIgError, FloatArray, Rigid, read_only_arrays
from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.guidance.devices.tracked import TrackedTool
from dvf_ig.guidance.servo import Servo, ServoInputs
from dvf_ig.io import limits
from dvf_ig.session import Event, GuidanceState, Landmark, Rearm, Session, ToolPose

from .answers import force_message, last_messages, pose_message, state_messages
from .events import EventSource
from .link import Inbox, Link
from .priority import SESSION, schedule_first
from .record import NO_RECORD, Record
from .timed import LiveEvent

ANSWERS_HZ = 60.0
STATE_EVERY_S = 0.01
STATES_SENT_EVERY_S = 0.1
"""STATUS and STRING are for people."""
TICK_WITHIN_S = 0.005
"""A servo that has not ticked for so long after it was told something is not waited for."""
LOOK_S = 0.0005
OLDEST_TICK_S = 0.05
"""The force of an older tick is not sent: the machine, or this process, stood still."""
SENTENCE_CHARACTERS = 400
MOST_AT_ONCE = 64
"""Messages taken between two answers: a flood is worked off without keeping the answers waiting."""
STILL = Rigid.identity("tracker", "device")


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """One answer that was sent.

    Attributes:
        state: of the session, on which it rests.
        force_n: (3,) the servo's, frame "tracker"; t_s is the session's time of its tick.
        servo, hazards: as of `SentForce`.
        latency_s: from the arrival of the newest tool pose in it until it was handed to the network; NaN
            where no new one was in it.
        offset_s: the clock of the tool's peer less the session's.
    """

    state: GuidanceState
    t_s: float
    force_n: FloatArray
    servo: SupervisorState
    hazards: Hazard
    latency_s: float
    offset_s: float


@dataclass(slots=True)
class LiveLoop:
    """One live session.

    Attributes:
        session, servo, device: the engine, and the servo, which runs, with the tool that it reads.
        source: makes events of what is in the inbox.
        link: takes the answers.
        more_events: events from elsewhere than the peers, since the last call.
        observe: is told every answer; `watch` every event that was pushed.
        tell: is told a sentence about what cannot be used.
        record: is told everything in order.
    """

    session: Session
    servo: Servo
    device: TrackedTool
    source: EventSource
    inbox: Inbox
    link: Link
    more_events: Callable[[], list[LiveEvent]]
    observe: Callable[[Answer], None]
    tell: Callable[[str], None]
    watch: Callable[[Event], None] = lambda _: None
    landmarks: tuple[Landmark, ...] = ()
    record: Record = NO_RECORD
    clock: Callable[[], float] = time.monotonic
    began: bool = False
    refused: int = 0
    """Events that the session did not use."""
    _state_s: float = float("-inf")
    _answer_s: float = float("-inf")
    _states_sent_s: float = float("-inf")
    _tool_arrived_s: float = float("nan")
    _told_tick: int = -1
    _told_s: float = 0.0
    _state: GuidanceState | None = None
    _rearm_asked: bool = False

    def run(self, stop: threading.Event) -> None:
        """Until `stop`, or an error; either way the peers get no force, and why, before it returns."""
        schedule_first(SESSION)
        try:
            while not stop.is_set():
                self.step()
        except BaseException as error:
            self._withdraw(f"the session failed ({type(error).__name__}: {error}); start it again")
            raise
        self._withdraw("the session has ended")

    def _withdraw(self, sentence: str) -> None:
        """The last messages; nothing that can fail is asked for them."""
        shown = sentence.encode("ascii", "replace").decode()[:SENTENCE_CHARACTERS]
        stamp_s = min(max(0.0, self.clock() + self.source.tool_offset_s), limits.WIRE_TIME_S)
        self.link.send_last(last_messages(shown, stamp_s))

    def ask_rearm(self) -> None:
        """The operator at this machine asks for force again; no peer can."""
        self._rearm_asked = True

    def step(self) -> None:
        """Take what has arrived, and answer where an answer is due."""
        waiting = self._told_tick >= 0
        arrivals = self.inbox.take(LOOK_S if waiting else STATE_EVERY_S, MOST_AT_ONCE)
        tool_came = False
        for arrival in arrivals:
            for event in self.source.events(arrival):
                tool_came |= self._push(event)
        now_s = self.clock()
        for event in (*self.source.overdue(now_s), *self.more_events()):
            self._push(event)
        if not self.began:
            return
        if self._rearm_asked:
            self._rearm()
        if tool_came or now_s - self._state_s >= STATE_EVERY_S:
            self._advance()
        if self._told_tick >= 0 and self._ticked():
            self._answer()

    def _push(self, event: LiveEvent) -> bool:
        """Whether the event was of the tool."""
        tool = isinstance(event.event, ToolPose)
        if tool and not self.began:
            self.began = True
            for landmark in self.landmarks:
                self.record.event(landmark, None)
                self.session.push(landmark)
        self.record.event(event.event, event.arrived_s)
        try:
            used = self.session.push(event.event, event.arrived_s)
        except DvfIgError as error:
            used = False
            self.tell(str(error))
        if not used:
            self.refused += 1
            return False
        if tool:
            self._tool_arrived_s = event.arrived_s
        self.watch(event.event)
        return tool

    def _advance(self) -> None:
        """A state, and what the servo is told of it."""
        now_s = self._state_s = self.clock()
        state = self._state = self.session.state(now_s)
        self.record.state(state)
        if not state.tool.hazard:
            self.device.publish(state.tool.tip_tracker_mm, state.tool.velocity_mm_s, now_s)
        self.servo.publish(
            ServoInputs(
                state.transform,
                self.clock(),
                STILL,
                hazards=state.supervised.hazards,
                tool_status=Status.STALE_TOOL if state.tool.hazard else Status.OK,
                margin_mm=state.margin_mm,
            )
        )
        if self._told_tick < 0 and now_s - self._answer_s >= 1.0 / ANSWERS_HZ - STATE_EVERY_S / 20:
            self._told_tick, self._told_s = self.servo.ticks, now_s

    def _ticked(self) -> bool:
        """Whether the servo has run a whole tick with what it was told, or does not run."""
        return self.servo.ticks >= self._told_tick + 2 or self.clock() - self._told_s > TICK_WITHIN_S

    def _answer(self) -> None:
        state = self._state
        sent = self.servo.newest()
        self._told_tick = -1
        if state is None or sent is None:
            return
        offset_s = self.source.tool_offset_s - self.session.clock_correction_s(ToolPose)
        stamp_s = max(0.0, state.now_s + offset_s)
        messages = [*pose_message(state, stamp_s), force_message(sent.force_n, max(0.0, sent.t_s + offset_s))]
        if state.now_s - self._states_sent_s >= STATES_SENT_EVERY_S:
            self._states_sent_s = state.now_s
            problems = (self.source.problem(state.now_s), self.record.problem)
            messages += state_messages(state, sent.state, sent.hazards, stamp_s, *problems)
        self.link.send(messages)
        sent_s = self._answer_s = self.clock()
        latency_s, self._tool_arrived_s = sent_s - self._tool_arrived_s, float("nan")
        self.record.answer(state, sent.t_s, sent.force_n)
        self.observe(Answer(state, sent.t_s, sent.force_n, sent.state, sent.hazards, latency_s, offset_s))

    def _rearm(self) -> None:
        self._rearm_asked = False
        event = Rearm(self.clock())
        self.record.event(event, None)
        self.session.push(event)
        self._advance()
        self.servo.rearm()


def no_more() -> list[LiveEvent]:
    """Where all events come from the peers."""
    return []
