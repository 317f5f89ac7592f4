"""A scenario streamed over loopback at real speed by another process, taken by a live session."""

import multiprocessing
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import InvalidInputError, Landmarks
from dvf_ig.guidance import SupervisorState
from dvf_ig.intake import read_scenario
from dvf_ig.intake.live import EcgFieldConfig, LiveConfig
from dvf_ig.live.igtl import Message, Transform, encode
from dvf_ig.live.link import Link, listen
from dvf_ig.live.loop import Answer, LiveLoop
from dvf_ig.live.player import play
from dvf_ig.live.serve import LiveOptions, SessionThread, live_session
from dvf_ig.live.summary import LiveSummary
from dvf_ig.replay.operator import REARM_AFTER_S, SimulatedOperator
from dvf_ig.session import EcgSource, SessionHistory, SessionSetup

ORIGIN_S = 1.0e6
"""Stamps are those of the recording and this: float64 then resolves a ten-thousandth of a microsecond."""
SETTLE_S = 1.0
"""The session goes on for so long after the last message."""
CONNECT_WITHIN_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class LiveRun:
    """What a live session did with a recording.

    Attributes:
        answers: in order.
        history: of the session, by its clock.
        offset_s: recording's time less the session's.
        result: of `LiveSummary`.
    """

    answers: tuple[Answer, ...]
    history: SessionHistory
    offset_s: float
    result: dict[str, Any]


def run_live(
    folder: Path,
    setup: SessionSetup,
    landmarks: tuple[Landmarks, Landmarks] | None,
    cut_s: float | None = None,
) -> LiveRun:
    """Stream a scenario folder to a live session on this machine.

    Args:
        setup, landmarks: as a replay of it has them.
        cut_s: so long after the beginning the other process sends half a message and closes the connection.
    Raises:
        InvalidInputError: beats from a trigger, or a stream that did not begin.
    """
    if not isinstance(setup.beat_source, EcgSource):
        raise InvalidInputError("a live session is compared on an ECG; this recording has a trigger")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=stream_folder, args=(folder, cut_s, theirs), daemon=True)
    child.start()
    try:
        if not ours.poll(CONNECT_WITHIN_S):
            raise InvalidInputError(f"{folder} could not be streamed within {CONNECT_WITHIN_S:g} s")
        config = LiveConfig(port=ours.recv(), ecg=EcgFieldConfig(rate_hz=setup.beat_source.rate_hz))
        return _taken(config, setup, landmarks, ours)
    finally:
        child.kill()
        child.join()


def stream_folder(folder: Path, cut_s: float | None, told: Connection) -> None:
    """In the other process: say the port, wait for a word, stream, and say that it is over."""
    scenario = read_scenario(folder, truth=False)
    with listen("127.0.0.1", 0, None) as link:
        told.send(link.port)
        told.recv()
        stop = threading.Event()
        while not link.peers:
            stop.wait(0.01)
        if cut_s is not None:
            threading.Timer(cut_s, _cut, (link,)).start()
        told.send(play(scenario, link, speed=1.0, origin_s=ORIGIN_S, stop=stop))
        told.recv()


def _cut(link: Link) -> None:
    """Half a message, and the end; the other side may connect again."""
    whole = encode(Message("ToolToTracker", 1.0, Transform(np.eye(4))))
    for peer in link.peers:
        peer.offer(whole[: len(whole) // 2])
        peer.close()


def _taken(
    config: LiveConfig, setup: SessionSetup, landmarks: tuple[Landmarks, Landmarks] | None, child: Connection
) -> LiveRun:
    answers: list[Answer] = []
    history, summary, operator = SessionHistory(), LiveSummary(), _Operator()

    def observe(answer: Answer) -> None:
        answers.append(answer)
        summary.add(answer)
        if operator.rearms(answer):
            loop.ask_rearm()

    options = LiveOptions(config, landmarks=landmarks, observe=observe, history=history)
    with live_session(setup, options) as loop:
        thread = SessionThread(loop)
        thread.start()
        child.send("begin")
        child.recv()
        thread.join(SETTLE_S)
        thread.end()
        result = summary.result(loop)
        child.send("end")
        return LiveRun(tuple(answers), history, _offset_s(loop), result)


def _offset_s(loop: LiveLoop) -> float:
    return loop.source.tool_offset_s - ORIGIN_S


class _Operator:
    """The operator of a replay, who re-arms the servo as well as the session."""

    def __init__(self) -> None:
        self._session = SimulatedOperator()
        self._latched_s: float | None = None

    def rearms(self, answer: Answer) -> bool:
        if self._session.action(answer.state) is not None:
            return True
        latched = answer.servo is SupervisorState.LATCHED
        if not latched or answer.state.supervisor > SupervisorState.DEGRADED:
            self._latched_s = None
            return False
        if self._latched_s is None:
            self._latched_s = answer.t_s
        if answer.t_s - self._latched_s < REARM_AFTER_S:
            return False
        self._latched_s = answer.t_s
        return True
