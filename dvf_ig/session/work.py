"""Long work of a session: who does it, and the queue of registrations and beats until their results are due.

A session requests work at one moment and takes its result at another, both in the time of its events. If the
result must not depend on how fast the machine is, as in a replay, an executor waits for it; live, the session
goes on without it. Frames are gathered a moment after the request, when all of them have arrived; a
registration takes effect COMPUTE_S after its request, a beat BEAT_COMPUTE_S after its R peak was detected, or
as soon afterwards as the executor has finished.
"""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import inf
from types import TracebackType
from typing import Generic, Protocol, TypeVar

from dvf_ig.cardiac import RPeak
from dvf_ig.registration import PoseEstimate

from .beat_evaluation import BEAT_COMPUTE_S, ComparedBeat
from .ultrasound_registration import RegistrationRecord, RegistrationRequest

T = TypeVar("T")
R_co = TypeVar("R_co", covariant=True)
WORKERS = 2
"""Threads: a registration takes seconds; the beats that end meanwhile are evaluated in the other one."""
COMPUTE_S = 3.0
"""A registration takes effect this long after its last frame: a fixed allowance for computing it."""
LATEST_S = 12.0
"""A result that comes this late is dropped: the frames it is made of are too old."""
GATHER_S = 0.35
"""Frames are gathered this long after a registration was requested: the longest gap of poses, and images that
are stamped up to COVERED_LAG_S after what they show; later stamps take as much longer."""
COVERED_LAG_S = 0.1
"""Delay of stamps that GATHER_S covers."""
BEAT_GATHER_S = 0.05
"""Frames of a beat are gathered this long after its R peak was detected, some 0.12 s after its last frame."""
LATEST_BEAT_S = 3.0
"""A beat that is compared this late is dropped: it is evidence of a pose that is too old."""
POLL_S = 0.01
"""Interval of checks whether overdue work is finished."""
REMEMBERED_PEAKS = 100
"""R peaks that place frames in the cardiac cycle."""


# ------------------------------------------------------------------ executors


class Job(Protocol[R_co]):
    """Work that was handed to an executor."""

    def done(self) -> bool:
        """Check whether `result` may be taken."""

    def result(self) -> R_co:
        """Return the result of the work, or raise its exception."""


class Executor(Protocol):
    """Takes work that depends on nothing but its own values."""

    def submit(self, work: Callable[[], T]) -> Job[T]: ...


@dataclass(slots=True)
class _Deferred(Generic[T]):
    work: Callable[[], T]

    def done(self) -> bool:
        return True

    def result(self) -> T:
        return self.work()


def answered(value: T) -> Job[T]:
    """Return a job that needs no work."""
    return _Deferred(lambda: value)


class InlineExecutor:
    """Lets the caller do the work when its result is due; work that is never due is never done."""

    def submit(self, work: Callable[[], T]) -> Job[T]:
        return _Deferred(work)


@dataclass(slots=True)
class _Running(Generic[T]):
    future: "Future[T]"
    waits: bool

    def done(self) -> bool:
        return self.waits or self.future.done()

    def result(self) -> T:
        return self.future.result()


class ThreadedExecutor:
    """Does the work in threads; a context manager that ends with them.

    Args:
        waits: wait for a result that is due: the same events give the same bits on any machine. False lets
            the session go on without it, as live.
    """

    def __init__(self, *, waits: bool) -> None:
        self._waits = waits
        self._pool = ThreadPoolExecutor(WORKERS)

    def __enter__(self) -> "ThreadedExecutor":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(cancel_futures=True)

    def submit(self, work: Callable[[], T]) -> Job[T]:
        return _Running(self._pool.submit(work), self._waits)


# ------------------------------------------------------------------ the queue


class UltrasoundSource(Protocol):
    """The ultrasound that has arrived, as jobs."""

    def register(self, request: RegistrationRequest, known_s: float) -> Job[RegistrationRecord]:
        """Register frames recorded by `known_s`."""

    def beat(
        self, peaks: tuple[RPeak, ...], known_s: float, tested: PoseEstimate | None, *, in_use: bool
    ) -> Job[ComparedBeat]:
        """Compare the beat that the last R peak ended with an estimate, unless that is None."""


@dataclass(frozen=True, slots=True, eq=False)
class FinishedRegistration:
    """Record of a registration; `cancelled` if it was cancelled while it was made."""

    record: RegistrationRecord
    cancelled: bool


@dataclass(frozen=True, slots=True, eq=False)
class FinishedBeat:
    """A beat, and the pose that it was compared with; None without one, or if the beat was dropped."""

    compared: ComparedBeat
    tested: PoseEstimate | None


@dataclass(slots=True)
class _Registration:
    """A registration that was requested; the job is None until its frames are gathered."""

    request: RegistrationRequest
    next_s: float
    job: Job[RegistrationRecord] | None = None
    cancelled: bool = False


@dataclass(slots=True)
class _Beat:
    """A beat that has ended; the job is None until its frames are gathered."""

    peaks: tuple[RPeak, ...]
    next_s: float
    tested: PoseEstimate | None = None
    job: Job[ComparedBeat] | None = None


class WorkQueue:
    """Registrations and beats between their request and the moment their result is taken.

    Args:
        source: the ultrasound that has arrived.
        lag_s: t_tracker(event) = t_video + lag_s.
    """

    def __init__(self, source: UltrasoundSource, lag_s: float) -> None:
        self._source = source
        self._gather_s = GATHER_S + max(0.0, -lag_s - COVERED_LAG_S)
        self._registrations: list[_Registration] = []
        self._beats: deque[_Beat] = deque()
        self._peaks: deque[RPeak] = deque(maxlen=REMEMBERED_PEAKS)

    @property
    def peaks(self) -> tuple[RPeak, ...]:
        """The last R peaks."""
        return tuple(self._peaks)

    @property
    def next_s(self) -> float:
        """When something is to be done next; infinite without work."""
        next_s = self._beats[0].next_s if self._beats else inf
        for one in self._registrations:
            next_s = min(next_s, one.next_s)
        return next_s

    def register(self, request: RegistrationRequest) -> None:
        """Register frames once all of them have arrived."""
        self._registrations.append(_Registration(request, request.until_s + self._gather_s))

    def cancel_registrations(self) -> None:
        """Mark those that were requested before as not to be used."""
        for one in self._registrations:
            one.cancelled = True

    def add_peak(self, peak: RPeak) -> None:
        """Add an R peak that was detected, and the beat that ended with it."""
        self._peaks.append(peak)
        if len(self._peaks) > 1:
            self._beats.append(_Beat(tuple(self._peaks), peak.detected_at_s + BEAT_GATHER_S))

    def take_registration(self, now_s: float) -> FinishedRegistration | None:
        """Take the first registration that is due and finished, or too late to wait for."""
        for one in self._registrations:
            if one.job is None or one.next_s > now_s:
                continue
            finished, asked_s = one.job.done(), one.request.until_s
            if not finished and now_s < asked_s + LATEST_S:
                one.next_s = now_s + POLL_S
                continue
            self._registrations.remove(one)
            late = one.request.record(None, failure="not finished in time")
            record = replace(one.job.result() if finished else late, ready_s=now_s)
            return FinishedRegistration(record, one.cancelled)
        return None

    def advance(self, now_s: float, tested: PoseEstimate | None, *, in_use: bool) -> FinishedBeat | None:
        """Hand gathered frames to the source, or take the oldest beat if it is finished.

        Args:
            tested: the pose that a beat whose frames are gathered now is compared with; `in_use`: forces
                depend on it.
        """
        for one in self._registrations:
            if one.job is None and one.next_s <= now_s:
                one.job = self._source.register(one.request, now_s)
                one.next_s = max(now_s, one.request.until_s + COMPUTE_S)
                return None
        if not self._beats or self._beats[0].next_s > now_s:
            return None
        beat = self._beats[0]
        detected_s = beat.peaks[-1].detected_at_s
        if beat.job is None:
            beat.tested, beat.job = tested, self._source.beat(beat.peaks, now_s, tested, in_use=in_use)
            beat.next_s = max(now_s, detected_s + BEAT_COMPUTE_S)
            return None
        if now_s >= detected_s + LATEST_BEAT_S:
            self._beats.popleft()
            return FinishedBeat(ComparedBeat(None, None, irregular=False), None)
        if not beat.job.done():
            beat.next_s = now_s + POLL_S
            return None
        self._beats.popleft()
        return FinishedBeat(beat.job.result(), beat.tested)
