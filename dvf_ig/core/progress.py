"""Progress callbacks and thread pools of long computations."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

Progress = Callable[[float], None]
"""Callback called with the fraction of the work done, 0 to 1."""


def part_of(progress: Progress, k: int, parts: int) -> Progress:
    """Return the callback of part `k` of equal `parts`, which calls `progress` with the overall fraction."""
    return lambda share: progress((k + share) / parts)


def untold(_: float) -> None:
    """Ignore progress."""


@contextmanager
def thread_pool(threads: int) -> Iterator[ThreadPoolExecutor]:
    """Provide a pool of threads; an exception in the caller, such as Ctrl-C, does not wait for its tasks.

    Tasks that have begun run on in the background, the others never begin. Without an exception all tasks are
    finished at the end.
    """
    pool = ThreadPoolExecutor(threads)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
