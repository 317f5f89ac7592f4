"""Who does the long work of a session: the caller when its result is due, or threads beside it.

A session asks for work at one moment and takes its result at another, both in the time of its events. Where
the result must not depend on how fast the machine is, as in a replay, an executor waits for it; live, the
session goes on without it.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Protocol, TypeVar

T = TypeVar("T")
R_co = TypeVar("R_co", covariant=True)
WORKERS = 2
"""A registration takes seconds; the beats that end meanwhile are evaluated beside it."""


class Job(Protocol[R_co]):
    """Work that was handed to an executor."""

    def done(self) -> bool:
        """Whether `result` may be taken."""
        ...

    def result(self) -> R_co:
        """What the work returned, or its exception."""
        ...


class Executor(Protocol):
    """Takes work that depends on nothing but what it holds."""

    def submit(self, work: Callable[[], T]) -> Job[T]: ...


@dataclass(slots=True)
class _Deferred(Generic[T]):
    work: Callable[[], T]

    def done(self) -> bool:
        return True

    def result(self) -> T:
        return self.work()


def answered(value: T) -> Job[T]:
    """A job that needs no work."""
    return _Deferred(lambda: value)


class InCaller:
    """Work is done by the caller when its result is due; what is never due is never done."""

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


class Beside:
    """Work is done by threads beside the caller; a context manager that ends with them.

    Args:
        waits: a result that is due is waited for: the same events give the same bits on any machine. False
            lets the session go on without it, as live.
    """

    def __init__(self, *, waits: bool) -> None:
        self._waits = waits
        self._pool = ThreadPoolExecutor(WORKERS)

    def __enter__(self) -> "Beside":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.shutdown(cancel_futures=True)

    def submit(self, work: Callable[[], T]) -> Job[T]:
        return _Running(self._pool.submit(work), self._waits)
