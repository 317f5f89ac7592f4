"""Executors do the long work; the queue takes its results when they are due."""

import threading
from math import inf
from typing import Any

import pytest

from dvf_ig.cardiac import RPeak
from dvf_ig.core import Rigid
from dvf_ig.session import InlineExecutor, Job, RegistrationRecord, RegistrationRequest, ThreadedExecutor
from dvf_ig.session.work import LATEST_BEAT_S, POLL_S, WorkQueue, answered


def test_inline_work_is_done_when_the_result_is_due_and_not_before() -> None:
    calls: list[int] = []

    def work() -> int:
        calls.append(1)
        return 5

    job = InlineExecutor().submit(work)
    assert job.done()
    assert not calls
    assert job.result() == 5
    assert calls == [1]
    assert answered("known").result() == "known"


def test_threads_go_on_while_the_caller_does_not_wait() -> None:
    gate = threading.Event()
    with ThreadedExecutor(waits=False) as executor:
        late, quick = executor.submit(lambda: gate.wait(10.0)), executor.submit(lambda: 3)
        assert quick.result() == 3
        assert quick.done()
        assert not late.done()
        gate.set()
        assert late.result() is True
        assert late.done()


def test_a_caller_that_waits_may_always_take_the_result() -> None:
    gate = threading.Event()
    with ThreadedExecutor(waits=True) as executor:
        job = executor.submit(lambda: gate.wait(10.0))
        assert job.done()
        threading.Timer(0.02, gate.set).start()
        assert job.result() is True


@pytest.mark.parametrize("waits", [True, False])
def test_an_exception_comes_with_the_result(waits: bool) -> None:
    with ThreadedExecutor(waits=waits) as executor:
        job = executor.submit(lambda: 1 // 0)
        with pytest.raises(ZeroDivisionError):
            job.result()


def test_leaving_ends_the_threads_and_forgets_what_has_not_begun() -> None:
    before, gate = threading.active_count(), threading.Event()
    begun: list[int] = []

    def work() -> None:
        begun.append(1)
        gate.wait(10.0)

    with ThreadedExecutor(waits=False) as executor:
        for _ in range(10):
            executor.submit(work)
        threading.Timer(0.05, gate.set).start()
    assert threading.active_count() <= before + 1  # the timer
    assert len(begun) < 10


class NeverFinished:
    """Work that no executor ever finishes."""

    def done(self) -> bool:
        return False

    def result(self) -> Any:
        raise AssertionError("taken before it was finished")

    def register(self, request: RegistrationRequest, known_s: float) -> Job[RegistrationRecord]:
        return self

    def beat(self, peaks: tuple[RPeak, ...], known_s: float, pose: Rigid | None, *, in_use: bool) -> Job[Any]:
        return self


def test_beats_that_are_never_finished_are_given_up_in_order() -> None:
    queue = WorkQueue(NeverFinished(), 0.0)
    for k in range(4):
        queue.add_peak(RPeak(0.8 * k, 0.8 * k + 0.12, 1.0))
    dropped_s: list[float] = []
    while queue.next_s < inf:
        now_s = max(queue.next_s, dropped_s[-1] if dropped_s else 0.0)
        beat = queue.advance(now_s, None, in_use=False)
        if beat is not None:
            assert (beat.compared.slices, beat.tested) == (None, None)
            dropped_s.append(now_s)
    assert dropped_s == pytest.approx([0.8 * k + 0.12 + LATEST_BEAT_S for k in (1, 2, 3)], abs=POLL_S)
