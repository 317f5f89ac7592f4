"""Threads of the synthetic world: each pool is created, used and closed here.

Work is split in the same way for any number of threads, and NumPy and the kernels release the interpreter:
the result never depends on the number of threads.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from numba import config

THREADS = min(2, int(config.NUMBA_NUM_THREADS))
"""Default number of threads; one if NUMBA_NUM_THREADS is 1, as in parallel processes."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], threads: int = THREADS
) -> Iterator[Result]:
    """Yield results of `work` in the order of `items`, each as soon as it and those before it are done."""
    with ThreadPoolExecutor(max(1, threads)) as pool:
        yield from pool.map(work, items)


def for_each(work: Callable[[Item], object], items: Iterable[Item], threads: int = THREADS) -> None:
    """Do `work` on every item; return when all is done, or raise the first failure's error."""
    deque(in_order(work, items, threads), maxlen=0)
