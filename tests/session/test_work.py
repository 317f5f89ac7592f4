"""Who does the long work, and when its result may be taken."""

import threading

import pytest

from dvf_ig.session import InlineExecutor, ThreadedExecutor
from dvf_ig.session.work import answered


def test_the_caller_works_when_the_result_is_due_and_not_before() -> None:
    done: list[int] = []

    def work() -> int:
        done.append(1)
        return 5

    job = InlineExecutor().submit(work)
    assert job.done()
    assert not done
    assert job.result() == 5
    assert done == [1]
    assert answered("known").result() == "known"


def test_threads_go_on_beside_a_caller_that_does_not_wait() -> None:
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
