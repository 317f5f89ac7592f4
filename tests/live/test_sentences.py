"""Sentences are counted by kind, and a terminal that nobody reads keeps nobody waiting."""

import io
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
import typer
from waiting import WITHIN_S, until

from dvf_ig.cli.serve.log import LOG, LogLevel, logged
from dvf_ig.cli.serve.undrained import MOST_CHARACTERS, queued_stderr
from dvf_ig.guidance import SupervisorState
from dvf_ig.live.sentences import MOST_KINDS, REARM, CountedSentences, Narrator, counted
from dvf_ig.session import GuidanceState


def test_each_kind_is_told_at_once_and_then_counted() -> None:
    told: list[str] = []
    with counted(told.append) as sentences:
        for k in range(412):
            sentences(f"the frame at {k}.25 s is ({k}, 1) pixels")
        sentences("another kind")
        assert told == [
            "the frame at 0.25 s is (0, 1) pixels",
            "the frame at 9.25 s is (9, 1) pixels (10 times)",
            "the frame at 99.25 s is (99, 1) pixels (100 times)",
            "another kind",
        ]
    assert told[4:] == ["the frame at 411.25 s is (411, 1) pixels (412 times)"]


def test_kinds_without_end_are_bounded() -> None:
    told: list[str] = []
    sentences = CountedSentences(told.append)
    for k in range(1000):
        sentences("x" * (k + 1))
    sentences.finish()
    assert len(told) == MOST_KINDS + 1
    assert told[-1] == f"{1000 - MOST_KINDS} more sentences of other kinds are not shown"


class Pipe:
    """A stderr whose other end is read when a test wants it."""

    def __init__(self) -> None:
        self.read_end, write_end = os.pipe()
        self.stream = os.fdopen(write_end, "w", buffering=1)

    def close(self) -> None:
        os.close(self.read_end)
        self.stream.close()


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    one = Pipe()
    yield one
    one.close()


def test_what_is_written_arrives_in_order(pipe: Pipe, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", pipe.stream)
    before = sys.stderr
    with queued_stderr():
        for k in range(1000):
            typer.echo(f"line {k}", err=True)
    assert sys.stderr is before
    assert os.read(pipe.read_end, 1 << 16).decode() == "".join(f"line {k}\n" for k in range(1000))


def test_a_full_pipe_stops_nobody_and_the_end_has_a_limit(
    pipe: Pipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More than the pipe and the queue hold; without the queue the first line too many waits for ever."""
    monkeypatch.setattr(sys, "stderr", pipe.stream)
    finished = threading.Event()

    def write() -> None:
        with queued_stderr():
            for _ in range(2 * MOST_CHARACTERS // 100):
                typer.secho("x" * 100, err=True)
        finished.set()

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    until(finished.is_set)
    writer.join()
    assert set(os.read(pipe.read_end, 1 << 16).decode()) == {"x", "\n"}


def test_a_pipe_whose_reader_has_gone_stops_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    stream = os.fdopen(write_end, "w", buffering=1)
    monkeypatch.setattr(sys, "stderr", stream)
    begin_s = time.monotonic()
    with queued_stderr():
        for _ in range(100):
            typer.echo("nobody", err=True)
    assert time.monotonic() - begin_s < WITHIN_S
    stream.close()


def test_a_stream_without_a_file_is_written_too(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with queued_stderr():
        sys.stderr.write("text\n")
        with pytest.raises(TypeError, match="text is needed"):
            sys.stderr.write(b"bytes")
    assert stream.getvalue() == "text\n"


def test_changes_of_a_session_are_reported_once_and_a_latch_at_once(tmp_path: Path) -> None:
    said: list[str] = []
    narrator = Narrator(said.append)

    def step(now_s: float, supervisor: SupervisorState, *reasons: str) -> None:
        state = SimpleNamespace(
            now_s=now_s, supervisor=supervisor, reasons=reasons, registration=None, rearmed=None
        )
        narrator.state(cast("GuidanceState", state))

    narrator.peers(["127.0.0.1:18944"], None)
    for now_s in (5.0, 5.2, 5.4, 6.0):
        step(now_s, SupervisorState.FADE, "the patient is not registered")
    for now_s in (7.0, 7.1, 7.5):
        step(now_s, SupervisorState.OK)
    step(7.6, SupervisorState.FADE, "a flicker")
    step(7.7, SupervisorState.DEGRADED)
    step(9.0, SupervisorState.LATCHED, "the tool is lost")
    narrator.peers([], "127.0.0.1:18944: the peer closed the connection")
    assert said == [
        "connected: 127.0.0.1:18944",
        "the first pose of the tool has come: the session runs",
        "0.4 s: no force: the patient is not registered",
        "2.5 s: force is given",
        f"4.0 s: LATCHED, no force: the tool is lost; {REARM}",
        "disconnected: 127.0.0.1:18944: the peer closed the connection",
    ]


@pytest.mark.parametrize(("level", "shown"), [("info", ["connected"]), ("warning", [])])
def test_messages_go_to_the_terminal_and_with_times_to_a_file(
    level: LogLevel, shown: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "serve.log"
    with logged(level, file):
        LOG.info("connected")
        LOG.warning("100 %s of a frame")
    assert capsys.readouterr().err.splitlines() == shown
    lines = file.read_text(encoding="utf-8").splitlines()
    assert [line.split(maxsplit=2)[2] for line in lines] == [
        *(f"INFO {text}" for text in shown),
        "WARNING 100 %s of a frame",
    ]
