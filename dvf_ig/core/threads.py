"""Pools of threads that an interruption leaves at once."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


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
