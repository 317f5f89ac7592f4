"""Long work of a session, counted: a replay takes each result at the very question at which it was there."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from dvf_ig.session import Beside
from dvf_ig.session.executor import Job

from .record import Record

T = TypeVar("T")


class CountedWork:
    """Hands work on, and tells a record when it was found done.

    Args:
        beside: does the work.
        record: is told.
    """

    def __init__(self, beside: Beside, record: Record) -> None:
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
