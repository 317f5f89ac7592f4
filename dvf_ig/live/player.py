"""A recorded intervention sent as PLUS sends a live one: same names, same stamps, at real speed.

    ProbeToTracker, ToolToTracker   TRANSFORM; one that was not tracked has the field TransformStatus
    Image_Tracker                   IMAGE, stamped as its pose
    EcgData                         STRING of ECG_BATCH_S, with the time of its first sample in a field
    RespirationData                 STRING of one sample of a channel that follows the breath, or
    ChestToTracker                  TRANSFORM of a marker that does, without its rotation

Nothing of a scenario's truth is sent.
"""

import threading
import time
from collections.abc import Callable, Iterator
from heapq import merge
from operator import itemgetter
from types import MappingProxyType

import numpy as np

from dvf_ig.core import InvalidInputError, PoseStream, Scenario, TriggerTimes

from .igtl import Image, Message, Text, Transform
from .link import Link

ECG_BATCH_S = 0.01
PROBE, TOOL, IMAGE, ECG = "ProbeToTracker", "ToolToTracker", "Image_Tracker", "EcgData"
BREATH, CHEST = "RespirationData", "ChestToTracker"
LONGEST_SLEEP_S = 0.1

Timed = tuple[float, Message]


def messages_of(scenario: Scenario, origin_s: float) -> Iterator[Timed]:
    """Everything that was recorded live, each with the recording's time at which it could be sent.

    Args:
        origin_s: is added to the recording's times to give stamps.
    Raises:
        InvalidInputError: no tool, or a trigger in place of an ECG.
    """
    if scenario.tool is None or isinstance(scenario.ecg, TriggerTimes):
        raise InvalidInputError("a recording that is streamed needs a tool and an ECG; one is missing")
    breath, tool = _breath(scenario, origin_s), _poses(scenario.tool, TOOL, origin_s)
    return merge(_ecg(scenario, origin_s), breath, _frames(scenario, origin_s), tool, key=itemgetter(0))


def play(
    scenario: Scenario,
    link: Link,
    *,
    speed: float,
    origin_s: float,
    stop: threading.Event,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Send a recording to every peer; ends with it, or with `stop`. Returns the number of messages.

    Args:
        speed: recorded seconds a second.
        origin_s: as of `messages_of`.
    """
    begin_s, first_s, sent = clock(), None, 0
    for t_s, message in messages_of(scenario, origin_s):
        first_s = t_s if first_s is None else first_s
        due_s = begin_s + (t_s - first_s) / speed
        while (left_s := due_s - clock()) > 0.0:
            if stop.wait(min(left_s, LONGEST_SLEEP_S)):
                return sent
        if stop.is_set():
            return sent
        link.send((message,))
        sent += 1
    return sent


def _poses(stream: PoseStream, name: str, origin_s: float) -> Iterator[Timed]:
    fields = _untracked()
    for i, t_s in enumerate(stream.t_s.tolist()):
        valid = bool(stream.valid[i])
        matrix = stream.pose(i).matrix if valid else np.eye(4)
        message = Message(name, t_s + origin_s, Transform(matrix), fields[valid])
        yield t_s, message


def _frames(scenario: Scenario, origin_s: float) -> Iterator[Timed]:
    ultrasound = scenario.ultrasound
    poses = _poses(ultrasound.stream("tracker", "probe"), PROBE, origin_s)
    for i, (t_s, pose) in enumerate(poses):
        yield t_s, pose
        if ultrasound.images is not None and ultrasound.image_valid[i]:
            yield t_s, Message(IMAGE, t_s + origin_s, Image(ultrasound.images[i][None], np.eye(4)))


def _breath(scenario: Scenario, origin_s: float) -> Iterator[Timed]:
    recorded = scenario.respiration
    if recorded is None:
        return
    for t_s, values in zip(recorded.t_s.tolist(), recorded.values, strict=True):
        if len(values) == 3:
            matrix = np.eye(4)
            matrix[:3, 3] = values
            yield t_s, Message(CHEST, t_s + origin_s, Transform(matrix))
        else:
            yield t_s, Message(BREATH, t_s + origin_s, Text(repr(float(values[0]))))


def _ecg(scenario: Scenario, origin_s: float) -> Iterator[Timed]:
    """A batch is sent when its last sample has been taken."""
    ecg = scenario.ecg
    if isinstance(ecg, TriggerTimes):
        return
    length = max(1, round(ECG_BATCH_S * ecg.rate_hz))
    for first in range(0, len(ecg), length):
        samples = ecg.samples[first : first + length]
        first_s = ecg.start_s + first / ecg.rate_hz
        last_s = first_s + (len(samples) - 1) / ecg.rate_hz
        fields = {f"{ECG}Timestamp": repr(first_s + origin_s), f"{ECG}Rate": repr(ecg.rate_hz)}
        if samples.shape[1] > 1:
            fields[f"{ECG}Leads"] = " ".join(ecg.leads)
        text = " ".join(map(repr, samples.ravel().tolist()))
        yield last_s, Message(ECG, last_s + origin_s, Text(text), MappingProxyType(fields))


def _untracked() -> dict[bool, MappingProxyType[str, str]]:
    """Fields of a pose by whether it was tracked."""
    return {True: MappingProxyType({}), False: MappingProxyType({"TransformStatus": "MISSING"})}
