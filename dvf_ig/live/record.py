"""Record of a live session: its log and its counted work, which a replay finds done at the same state."""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Generic, NamedTuple, Protocol, TypeVar

from dvf_ig.core import OutputError
from dvf_ig.intake.session_log.live import (
    LOST,
    Timed,
    answer_messages,
    event_messages,
    state_message,
    work_message,
)
from dvf_ig.io.ros.log_file import UNFINISHED, LogWriter, require_log_packages
from dvf_ig.io.writing.place import failure_reason
from dvf_ig.session import Event, GuidanceState, Job, ThreadedExecutor, ToolPose, TrackedFrame

from .priority import RECORDING, schedule_first

LOG, PART = "session.mcap", f"session-{UNFINISHED}"
"""Names of a record that is whole, and of one that is being written or whose program was killed."""
MOST_WAITING_BYTES = 256 << 20
"""20 s of a scanner's images of 640 × 480 at 40 Hz."""
SMALL_BYTES = 1024
"""Memory of what holds no image, about."""
CHUNK_BYTES = 64 << 10
"""A kill loses at most so much of what was handed over, a second without images."""
WAKE_S = 0.05


class Record(Protocol):
    """Interface of a live session's record; no call waits."""

    @property
    def problem(self) -> str | None:
        """Problem of the record, as a sentence for the user; None if there is none."""

    def event(self, event: Event, arrived_s: float | None) -> None:
        """Before it is pushed."""

    def state(self, state: GuidanceState) -> None:
        """One that the session was asked for."""

    def answer(self, state: GuidanceState) -> None:
        """Answer that was sent."""

    def work(self, number: int, refused: int) -> None:
        """Work was found done after it had been asked for `refused` times."""


class _NoRecord:
    problem: str | None = None

    def event(self, event: Event, arrived_s: float | None) -> None:
        pass

    def state(self, state: GuidanceState) -> None:
        pass

    def answer(self, state: GuidanceState) -> None:
        pass

    def work(self, number: int, refused: int) -> None:
        pass


NO_RECORD: Record = _NoRecord()


class _Waiting(NamedTuple):
    """Pending entry: a function that makes its messages, and the memory that it holds."""

    messages: Callable[[], Iterable[Timed]]
    size: int


class SessionRecord:
    """A log that grows (see `session_record`).

    Args:
        log: with everything attached; its messages go to `stream`.
        tell: called once with a sentence when something goes wrong.
    """

    def __init__(self, log: LogWriter, stream: IO[bytes], path: Path, tell: Callable[[str], None]) -> None:
        self._log, self._stream, self._path, self._tell = log, stream, path, tell
        self._waiting: deque[_Waiting] = deque()
        self._bytes_in = self._bytes_out = 0
        self._now_s = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._write_all, name="dvf-ig record", daemon=True)
        self._missing = {ToolPose: "pose of the tool", TrackedFrame: "ultrasound"}
        self.lost = 0
        """Events, states and answers that were left out."""
        self.failure: str | None = None
        """Why the record ended before its session; None where it did not."""

    @property
    def empty(self) -> bool:
        """Whether no event, state or answer came."""
        return self._bytes_in == 0 and self.lost == 0

    @property
    def missing(self) -> str | None:
        """First stream that a replay needs of which nothing came; None if none is missing."""
        return next(iter(self._missing.values()), None)

    @property
    def problem(self) -> str | None:
        if self.failure is not None:
            return f"the record ended, the session goes on: {self.failure}"
        if self.lost:
            return f"the disk is too slow for the record: {self.lost} messages are not in it"
        return None

    def event(self, event: Event, arrived_s: float | None) -> None:
        self._missing.pop(type(event), None)
        image = event.image if isinstance(event, TrackedFrame) else None
        size = SMALL_BYTES if image is None else SMALL_BYTES + image.nbytes
        arrived = float("nan") if arrived_s is None else arrived_s
        self._put(lambda: event_messages(event, arrived), size)

    def state(self, state: GuidanceState) -> None:
        lost, self._now_s = self.lost, state.now_s
        self._put(lambda: (state_message(state, lost),), SMALL_BYTES)

    def answer(self, state: GuidanceState) -> None:
        self._put(lambda: answer_messages(state), SMALL_BYTES)

    def work(self, number: int, refused: int) -> None:
        now_s = self._now_s
        self._put(lambda: (work_message(now_s, number, refused),), SMALL_BYTES)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def finish(self) -> bool:
        """Write what waits, and the end; whether the record is whole but for what was lost."""
        self._stop.set()
        self._thread.join()
        if self.failure is not None or self._waiting:
            return False
        try:
            self._log.note(LOST, self.lost)
            self._log.finish()
            self._stream.flush()
            os.fsync(self._stream.fileno())
        except OSError as exc:
            self._end(exc)
        return self.failure is None

    def _put(self, messages: Callable[[], Iterable[Timed]], size: int) -> None:
        """One thread counts in, the other out: neither waits."""
        if self.failure is not None:
            return
        if self._bytes_in - self._bytes_out + size > MOST_WAITING_BYTES:
            self.lost += 1
            return
        self._bytes_in += size
        self._waiting.append(_Waiting(messages, size))

    def _write_all(self) -> None:
        schedule_first(RECORDING)
        reported = False
        while self.failure is None:
            last = self._stop.is_set()
            self._write_waiting()
            if self.lost and not reported and self.problem is not None:
                reported = True
                self._tell(self.problem)
            if last:
                return
            self._stop.wait(WAKE_S)

    def _write_waiting(self) -> None:
        try:
            while self._waiting:
                one = self._waiting.popleft()
                for t_s, topic, kind, message in one.messages():
                    self._log.write(topic, kind, t_s, message)
                self._bytes_out += one.size
            self._stream.flush()
        except OSError as exc:
            self._end(exc)

    def _end(self, exc: OSError) -> None:
        self.failure = f"cannot write {self._path}: {failure_reason(exc, self._path)}"
        self._waiting.clear()
        self._tell(self.problem or "")


@contextmanager
def session_record(
    folder: Path, attach: Callable[[LogWriter], None], tell: Callable[[str], None]
) -> Iterator[SessionRecord]:
    """A record in a folder that exists: `PART` while it grows, `LOG` when the session has ended.

    None remains of a session that is refused, or fails, before anything came.

    Args:
        attach: attaches what a replay needs in addition to messages.
        tell: as of `SessionRecord`.
    Raises:
        MissingDependencyError: mcap or rosbags is absent.
        OutputError: the folder holds a record already, or cannot be written.
    """
    require_log_packages()
    path, whole = folder / PART, folder / LOG
    for one in (path, whole):
        if one.exists():
            raise OutputError(
                f"cannot write {one}: {folder} holds the record of a session, which is never replaced; "
                "choose another folder"
            )
    with _begun(path, attach) as (log, stream):
        record = SessionRecord(log, stream, path, tell)
        record.start()
        try:
            yield record
        except BaseException:
            record.finish()
            if record.empty:
                path.unlink()
            raise
        finished = record.finish()
    if finished:
        try:
            os.replace(path, whole)
        except OSError as exc:
            raise OutputError(f"cannot write {whole}: {failure_reason(exc, whole)}") from exc


@contextmanager
def _begun(path: Path, attach: Callable[[LogWriter], None]) -> Iterator[tuple[LogWriter, IO[bytes]]]:
    """A new log with its attachments; where they cannot be written there is none."""
    try:
        stream = path.open("xb")
    except OSError as exc:
        raise OutputError(f"cannot write {path}: {failure_reason(exc, path)}") from exc
    try:
        try:
            log = LogWriter(stream, CHUNK_BYTES)
            attach(log)
            log.end_attachments()
            stream.flush()
        except BaseException as exc:
            path.unlink()
            if isinstance(exc, OSError):
                raise OutputError(f"cannot write {path}: {failure_reason(exc, path)}") from exc
            raise
        yield log, stream
    finally:
        with suppress(OSError):  # of what a full disk did not take, which was reported when it happened
            stream.close()


T = TypeVar("T")


class CountedWork:
    """Executor that records at which question its work was finished.

    Args:
        beside: does the work.
        record: receives it.
    """

    def __init__(self, beside: ThreadedExecutor, record: Record) -> None:
        self._beside, self._record = beside, record
        self._count = 0

    def submit(self, work: Callable[[], T]) -> Job[T]:
        job = _Counted(self._beside.submit(work), self._count, self._record)
        self._count += 1
        return job


@dataclass(slots=True)
class _Counted(Generic[T]):
    job: Job[T]
    number: int
    record: Record
    refused: int = 0
    found: bool = False

    def done(self) -> bool:
        if not self.found:
            self.found = self.job.done()
            if self.found:
                self.record.work(self.number, self.refused)
            else:
                self.refused += 1
        return self.found

    def result(self) -> T:
        return self.job.result()
