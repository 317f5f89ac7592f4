"""The session's own thread on one screen: what arrived in, states with the servo's ticks, answers out.

    arrivals ─► events ─► Session.push        each with its arrival, so that clocks that run away are found
    now      ─► Session.state                 at every tool pose, and STATE_EVERY_S without one
    state    ─► force, pose, state to the peers, at most ANSWERS_HZ
                and inputs to the servo of a haptic device, whose tip is then the tool (`haptic`)

Nothing here waits for a peer or a registration. It begins with the first tool pose: before, no
tool is lost. However it ends, the last that it sends is no force, and why.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import inf

from dvf_ig.core import DvfIgError, FloatArray
from dvf_ig.guidance import SupervisorState
from dvf_ig.guidance.servo import SentForce
from dvf_ig.guidance.servo.inputs import VALID_FOR_S
from dvf_ig.io import limits
from dvf_ig.session import Event, GuidanceState, Landmark, Rearm, Session, ToolPose

from .answers import force_message, last_messages, pose_message, state_messages
from .events import EventSource
from .frames import LiveEvent
from .haptic import HapticTool
from .link import Inbox, Link
from .priority import SESSION, schedule_first
from .record import NO_RECORD, Record

ANSWERS_HZ = 60.0
STATE_EVERY_S = 0.01
STATES_SENT_EVERY_S = 0.1
"""STATUS and STRING are for people."""
OLDEST_STATE_S = 0.05
"""The force of an older state is not sent: the machine, or this process, stood still."""
SENTENCE_CHARACTERS = 400
MOST_AT_ONCE = 64
"""Messages taken between two answers: a flood is worked off without keeping the answers waiting."""


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """One answer that was sent.

    Attributes:
        state: of the session, with the force.
        latency_s: from the arrival of the newest tool pose in it until it was handed to the network; NaN
            where no new one was in it.
        offset_s: the clock of the tool's peer less the session's.
        sent: force of a haptic device's own servo; None without a device.
    """

    state: GuidanceState
    latency_s: float
    offset_s: float
    sent: SentForce | None = None

    @property
    def force_n(self) -> FloatArray:
        """(3,) N on the tool, frame "tracker"."""
        return self.state.force_n if self.sent is None else self.sent.force_n

    @property
    def supervisor(self) -> SupervisorState:
        """State of the servo whose force it is."""
        return self.state.supervisor if self.sent is None else self.sent.state


@dataclass(slots=True)
class LiveLoop:
    """One live session.

    Attributes:
        session: the engine.
        source: makes events of what is in the inbox.
        link: takes the answers.
        more_events: events from elsewhere than the peers, since the last call.
        observe: called with every answer, `watch` with every event that was pushed.
        tell: called with a sentence about what cannot be used.
        record: receives everything in order.
        haptic: device that is the tool; None if the peers send the tool's poses.
    """

    session: Session
    source: EventSource
    inbox: Inbox
    link: Link
    more_events: Callable[[], list[LiveEvent]]
    observe: Callable[[Answer], None]
    tell: Callable[[str], None]
    watch: Callable[[Event], None] = lambda _: None
    landmarks: tuple[Landmark, ...] = ()
    record: Record = NO_RECORD
    haptic: HapticTool | None = None
    clock: Callable[[], float] = time.monotonic
    began: bool = False
    refused: int = 0
    """Events that the session did not use."""
    _state_s: float = -inf
    _answer_s: float = -inf
    _states_sent_s: float = -inf
    _tool_arrived_s: float = float("nan")
    _began_s: float = float("nan")
    _silent_s: float = 0.0
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
        """The last messages; nothing that can fail is asked for them. A device's force ends before."""
        if self.haptic is not None:
            self.haptic.withdraw(sentence)
        shown = sentence.encode("ascii", "replace").decode()[:SENTENCE_CHARACTERS]
        stamp_s = min(max(0.0, self.clock() + self.source.tool_offset_s), limits.WIRE_TIME_S)
        self.link.send_last(last_messages(shown, stamp_s))

    def ask_rearm(self) -> None:
        """The operator at this machine asks for force again; no peer can."""
        self._rearm_asked = True

    def step(self) -> None:
        """Take what has arrived, and answer if an answer is due."""
        arrivals = self.inbox.take(STATE_EVERY_S, MOST_AT_ONCE)
        tool_came = False
        for arrival in arrivals:
            for event in self.source.events(arrival):
                tool_came |= self._push(event)
        now_s = self.clock()
        for event in (*self.source.overdue(now_s), *self.more_events()):
            self._push(event)
        if self.haptic is not None:
            for event in self.haptic.poses(now_s):
                tool_came |= self._push(event)
            self._rearm_asked |= self.haptic.rearm_pressed()
        if not self.began:
            return
        if self._rearm_asked:
            self._rearm()
        if tool_came or now_s - self._state_s >= STATE_EVERY_S:
            self._advance()

    def _push(self, event: LiveEvent) -> bool:
        """Whether the event was of the tool."""
        tool = isinstance(event.event, ToolPose)
        if self.haptic is not None and isinstance(event.event, ToolPose) and not event.event.by_encoders:
            self.haptic.follow(event.event)
            return False
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

    @property
    def running_share(self) -> float:
        """Share of the time since the first state in which the session was not silent to its servo."""
        whole_s = self._state_s - self._began_s
        return 1.0 - self._silent_s / whole_s if whole_s > 0.0 else 1.0

    def _advance(self) -> None:
        """Take a state, and answer if an answer is due."""
        state = self._next_state()
        if state.now_s - self._answer_s < 1.0 / ANSWERS_HZ - STATE_EVERY_S / 20:
            return
        if self.clock() - state.now_s <= OLDEST_STATE_S:
            self._answer(state)

    def _next_state(self) -> GuidanceState:
        now_s = self.clock()
        if self._state_s == -inf:
            self._began_s = now_s
        else:
            self._silent_s += max(0.0, now_s - self._state_s - VALID_FOR_S)
        self._state_s = now_s
        state = self.session.state(now_s)
        self.record.state(state)
        if self.haptic is not None:
            self.haptic.publish(state)
        return state

    def _answer(self, state: GuidanceState) -> None:
        offset_s = self.source.tool_offset_s - self.session.clock_correction_s(ToolPose)
        stamp_s = max(0.0, state.now_s + offset_s)
        sent = None if self.haptic is None else self.haptic.sent
        force_n = state.force_n if sent is None else sent.force_n
        messages = [*pose_message(state, stamp_s), force_message(force_n, stamp_s)]
        if state.now_s - self._states_sent_s >= STATES_SENT_EVERY_S:
            self._states_sent_s = state.now_s
            problems = (self.source.problem(state.now_s), self.record.problem)
            messages += state_messages(state, stamp_s, *problems, sent=sent)
        self.link.send(messages)
        sent_s = self._answer_s = self.clock()
        latency_s, self._tool_arrived_s = sent_s - self._tool_arrived_s, float("nan")
        self.record.answer(state)
        self.observe(Answer(state, latency_s, offset_s, sent))

    def _rearm(self) -> None:
        self._rearm_asked = False
        event = Rearm(self.clock())
        self.record.event(event, None)
        self.session.push(event)
        if self.haptic is not None:
            self.haptic.rearm()
        self._advance()


def no_more() -> list[LiveEvent]:
    """Where all events come from the peers."""
    return []
