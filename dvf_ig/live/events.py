"""Events of a session from arrived messages: senders, clocks of peers, and the order of arrival."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.core.plausible import identities
from dvf_ig.io import limits
from dvf_ig.session import Event, RespirationSample, ToolPose

from .devices import DeviceNames, Posed, Role
from .frames import SAME_S, FramePairing, LiveEvent
from .igtl import Message, WireError
from .link import Arrival
from .samples.field import EcgField
from .samples.respiration import BreathField

SETTLE_S = 1.0
FASTEST_S = 0.25
"""Largest plausible lead of a message over the median one."""
MOST_SEEN = 8192


@dataclass(slots=True)
class PeerClock:
    """Estimate of one peer's clock by this machine's monotonic clock, which is a session's time.

    The offset is the largest stamp minus arrival of the first second, so that the least latency counts as
    none; a stamp that is far from the median is wrong, not fast, and is ignored. Later changes of the peer's
    clock are found by the session (`dvf_ig.session.clocks`).
    """

    _seen_s: list[float] = field(default_factory=list, init=False)
    """Stamps less arrivals, until the clock has settled."""
    _offset_s: float = field(default=0.0, init=False)
    _first_s: float | None = field(default=None, init=False)
    settled: bool = field(default=False, init=False)

    def see(self, stamp_s: float, arrived_s: float) -> None:
        """Take a stamp and its arrival; no effect once the clock has settled."""
        if self._first_s is None:
            self._first_s = arrived_s
        self.settled = self.settled or arrived_s - self._first_s >= SETTLE_S
        if not self.settled and len(self._seen_s) < MOST_SEEN:
            self._seen_s.append(stamp_s - arrived_s)
        elif self._seen_s:
            self._offset_s = self.offset_s
            self._seen_s = []

    @property
    def offset_s(self) -> float:
        """Peer's clock minus this machine's; zero for a peer that stamps nothing."""
        if not self._seen_s:
            return self._offset_s
        usual_s = median(self._seen_s)
        return max(seen_s for seen_s in self._seen_s if seen_s <= usual_s + FASTEST_S)

    def local_s(self, stamp_s: float | None, arrived_s: float) -> float:
        """Convert a stamp to this machine's clock; the arrival if the sender gave none."""
        return arrived_s if stamp_s is None else stamp_s - self.offset_s


TOGETHER_S = 1.0
"""Silence after which a sending program counts as ended."""


@dataclass(slots=True)
class _Sender:
    """Sender without a break since `from_s`, last heard at `last_s`."""

    from_s: float
    last_s: float


@dataclass(slots=True)
class ToolSenders:
    """Programs that send the tool's poses: two at once are a problem, one that takes over is not."""

    _senders: dict[str, _Sender] = field(default_factory=dict, init=False)
    _problem: str | None = field(default=None, init=False)
    _problem_s: float = field(default=0.0, init=False)

    def alone(self, peer: str, arrived_s: float) -> bool:
        """Take a pose; return whether no other peer has sent one since this peer began."""
        last_s = arrived_s - TOGETHER_S
        self._senders = {name: one for name, one in self._senders.items() if one.last_s >= last_s}
        own = self._senders.setdefault(peer, _Sender(arrived_s, arrived_s))
        own.last_s = max(own.last_s, arrived_s)
        for name, other in self._senders.items():
            if name != peer and other.last_s > own.from_s:
                first, second = sorted((peer, name))
                self._problem_s = arrived_s
                self._problem = (
                    f"{first} and {second} both send the tool, which is taken as lost; end one of them"
                )
                return False
        return True

    def problem(self, now_s: float) -> str | None:
        """Describe for the user what is wrong now; None if nothing is."""
        return self._problem if now_s - self._problem_s < TOGETHER_S else None


REFERENCE_S = 0.1
"""A reference's pose counts for poses stamped up to so long after it: three frames at 30 Hz."""
MOST_HELD = 8192
MOST_CLOCKS = 64
"""Peers whose clocks are remembered: a server's clients come with a new name each time."""


class EventSource:
    """Turns what arrives into events; what is refused is counted and told.

    Args:
        names: of the devices.
        ecg: field in which the peers send the ECG; None if it comes from elsewhere.
        tell: called with a sentence about what cannot be used.
        breath: field in which the peers send what follows the breath; None if it is a marker, comes from
            elsewhere, or nothing follows it.
    """

    def __init__(
        self,
        names: DeviceNames,
        ecg: EcgField | None,
        tell: Callable[[str], None],
        breath: BreathField | None = None,
    ) -> None:
        self._names, self._ecg, self._tell, self._breath = names, ecg, tell, breath
        self._frames = FramePairing()
        self._clocks: dict[str, PeerClock] = {}
        self._held: deque[Arrival] = deque(maxlen=MOST_HELD)
        self._reference: tuple[float, FloatArray | None] | None = None
        self._senders = ToolSenders()
        self.refused = 0
        """Messages that were of no use though they were meant for the session."""
        self.tool_offset_s = 0.0
        """The clock of the tool's peer less this machine's."""

    def events(self, arrival: Arrival) -> list[LiveEvent]:
        """Events that a message completes; those of a peer's first second come together at its end."""
        stamp_s = arrival.taken.stamp_s
        if stamp_s is not None and stamp_s > limits.WIRE_TIME_S:
            self._refuse(
                f"a message of {arrival.peer} is stamped {stamp_s:.6g} s; needed at most "
                f"{limits.WIRE_TIME_S:g} s since 1970 or since its start: set the sender's clock"
            )
            return []
        clock = self._clock_of(arrival.peer)
        if stamp_s is not None:
            clock.see(stamp_s, arrival.arrived_s)
            if not clock.settled:
                self._held.append(arrival)
                return []
        waiting = [one for one in self._held if one.peer == arrival.peer]
        if waiting:
            self._held = deque((one for one in self._held if one.peer != arrival.peer), maxlen=MOST_HELD)
        return [event for one in (*waiting, arrival) for event in self._events(one, clock)]

    def problem(self, now_s: float) -> str | None:
        """Problem of the senders now, as a sentence for the user."""
        return self._senders.problem(now_s)

    def overdue(self, now_s: float) -> list[LiveEvent]:
        """Frames whose pose did not come."""
        return [LiveEvent(now_s, frame) for frame in self._frames.overdue(now_s)]

    def _clock_of(self, peer: str) -> PeerClock:
        """The clock of a peer; those that were asked for last are kept."""
        clock = self._clocks.pop(peer) if peer in self._clocks else PeerClock()
        self._clocks[peer] = clock
        if len(self._clocks) > MOST_CLOCKS:
            del self._clocks[next(iter(self._clocks))]
        return clock

    def _events(self, arrival: Arrival, clock: PeerClock) -> list[LiveEvent]:
        try:
            if isinstance(arrival.taken, WireError):
                self._refuse(str(arrival.taken))
                events = self._of_refused(arrival.taken, arrival, clock)
            else:
                events = self._of_message(arrival.taken, arrival, clock)
        except InvalidInputError as error:
            self._refuse(str(error))
            return []
        return [LiveEvent(arrival.arrived_s, event) for event in events]

    def _of_refused(self, error: WireError, arrival: Arrival, clock: PeerClock) -> list[Event]:
        posed = self._names.refused_pose(error)
        t_s = clock.local_s(error.stamp_s, arrival.arrived_s)
        return [] if posed is None else self._posed(posed, t_s, arrival, clock)

    def _of_message(self, message: Message, arrival: Arrival, clock: PeerClock) -> list[Event]:
        arrived_s = arrival.arrived_s
        t_s = clock.local_s(message.stamp_s, arrived_s)
        events: list[Event] = []
        poses = sorted(self._names.poses(message), key=lambda posed: posed.role is not Role.REFERENCE)
        for posed in poses:
            events += self._posed(posed, t_s, arrival, clock)
        if self._ecg is not None:
            samples = self._ecg.samples(message, t_s, clock.offset_s)
            events += [] if samples is None else [samples]
        if self._breath is not None:
            events += self._breath.samples(message, t_s, clock.offset_s)
        image = self._names.image_of(message)
        if image is not None:
            events += self._frames.add_image(t_s, image, arrived_s)
        return events

    def _posed(self, posed: Posed, t_s: float, arrival: Arrival, clock: PeerClock) -> list[Event]:
        if posed.matrix is not None and identities(posed.matrix):
            self._refuse(
                f"a pose of the {posed.role.value} is exactly the identity, as programs send it for a marker "
                "that they do not see; it counts as lost"
            )
            posed = Posed(posed.role, None)
        if posed.role is Role.REFERENCE:
            self._reference = (t_s, posed.matrix)
            return []
        matrix = self._against_reference(posed.matrix, t_s)
        if posed.role is Role.TOOL:
            self.tool_offset_s = clock.offset_s
            alone = self._senders.alone(arrival.peer, arrival.arrived_s)
            return [ToolPose(t_s, matrix if alone else None)]
        finite = matrix is not None and bool(np.isfinite(matrix).all())
        if posed.role is Role.CHEST:
            return [RespirationSample(t_s, matrix[:3, 3])] if finite and matrix is not None else []
        return list(self._frames.add_pose(t_s, matrix if finite else None))

    def _against_reference(self, matrix: FloatArray | None, t_s: float) -> FloatArray | None:
        """Pose relative to the reference marker, if there is one; None while that is not seen."""
        if self._names.reference is None or matrix is None:
            return matrix
        if self._reference is None or not -SAME_S <= t_s - self._reference[0] <= REFERENCE_S:
            return None
        tracker_from_reference = self._reference[1]
        if tracker_from_reference is None or not np.isfinite(tracker_from_reference).all():
            return None
        return np.asarray(np.linalg.solve(tracker_from_reference, matrix), dtype=np.float64)

    def _refuse(self, sentence: str) -> None:
        self.refused += 1
        self._tell(sentence)
