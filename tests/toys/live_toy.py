"""A live loop in simulated time: the toy's streams as messages with a latency."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from toy_session import ECG_HZ, Streams

from dvf_ig.core import FloatArray
from dvf_ig.live.devices import DeviceNames
from dvf_ig.live.events import EventSource
from dvf_ig.live.igtl import Image, Message, Text, Transform, WireError
from dvf_ig.live.link import MOST, Arrival, Inbox
from dvf_ig.live.loop import Answer, LiveLoop, no_more
from dvf_ig.live.samples.field import EcgField
from dvf_ig.live.samples.respiration import BreathField
from dvf_ig.session import Session

ORIGIN_S = 5000.0
"""The peer's clock less the local one's, but for the latency."""
LATENCY_S = 0.004
NAMES = DeviceNames("ProbeToTracker", "ToolToTracker", "Image_Tracker", chest="ChestToTracker")
STEP_S = 0.01
UNGUIDED_STEP_S = 0.05


class ReadyInbox(Inbox):
    """Never waits: time is simulated."""

    def take(self, wait_s: float, most: int = MOST) -> list[Arrival]:
        return super().take(0.0, most)


@dataclass
class Sent:
    """A link that keeps what was sent."""

    messages: list[Message] = field(default_factory=list)

    def send(self, messages: Iterable[Message]) -> None:
        self.messages += list(messages)

    send_last = send

    def named(self, device: str) -> list[Message]:
        return [message for message in self.messages if message.device == device]


class LiveToy:
    """A live session of the toy's patient, advanced by `run`; `guided_from_s` ends its longer steps."""

    def __init__(self, session: Session, guided_from_s: float = 0.0) -> None:
        self.guided_from_s = guided_from_s
        self.now_s, self.sent = 0.0, Sent()
        self.told: list[str] = []
        self.answers: list[Answer] = []
        self.inbox = ReadyInbox()
        link: Any = self.sent
        self.loop = LiveLoop(
            session=session,
            source=EventSource(NAMES, EcgField("EcgData", ECG_HZ), self.told.append, BreathField("Pressure")),
            inbox=self.inbox,
            link=link,
            more_events=no_more,
            observe=self.answers.append,
            tell=self.told.append,
            clock=lambda: self.now_s,
        )

    def run(self, arrivals: list[Arrival], until_s: float) -> None:
        """Let time pass in steps; arrivals in order."""
        waiting = [a for a in arrivals if a.arrived_s > self.now_s]
        while self.now_s < until_s - 1e-9:
            step_s = STEP_S if self.now_s >= self.guided_from_s else UNGUIDED_STEP_S
            self.now_s = round(min(self.now_s + step_s, until_s), 9)
            while waiting and waiting[0].arrived_s <= self.now_s:
                self.inbox.put(waiting.pop(0))
            self.loop.step()


def arrivals_of(streams: Streams, *, latency_s: float = LATENCY_S) -> list[Arrival]:
    """The streams as a peer sends them, in order of arrival; poses that are None are said to be missing."""
    found = []
    for batch in streams.ecg:
        last_s = batch.start_s + (len(batch.samples) - 1) / ECG_HZ
        fields = {"EcgDataTimestamp": repr(batch.start_s + ORIGIN_S)}
        text = Text(" ".join(map(repr, batch.samples.ravel().tolist())))
        found.append((last_s, Message("EcgData", last_s + ORIGIN_S, text, MappingProxyType(fields))))
    for frame in streams.frames:
        found.append((frame.t_s, pose_message("ProbeToTracker", frame.t_s, frame.tracker_from_probe)))
        if frame.image is not None:
            image = Image(frame.image[None], np.eye(4))
            found.append((frame.t_s, Message("Image_Tracker", frame.t_s + ORIGIN_S, image)))
    found += [
        (pose.t_s, pose_message("ToolToTracker", pose.t_s, pose.tracker_from_tool)) for pose in streams.tool
    ]
    found.sort(key=lambda timed: timed[0])
    return [arrival(t_s, message, latency_s) for t_s, message in found]


def pose_message(name: str, t_s: float, matrix: FloatArray | None) -> Message:
    """float32 as on the wire."""
    if matrix is None:
        return Message(
            name, t_s + ORIGIN_S, Transform(np.eye(4)), MappingProxyType({"TransformStatus": "MISSING"})
        )
    return Message(name, t_s + ORIGIN_S, Transform(matrix.astype(np.float32).astype(np.float64)))


def arrival(t_s: float, taken: Message | WireError, latency_s: float = LATENCY_S) -> Arrival:
    """Something that was sent at `t_s`."""
    return Arrival(t_s + latency_s, "plus", taken)
