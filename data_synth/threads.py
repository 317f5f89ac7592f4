"""The threads of the synthetic world: each pool is made, used up and closed here.

Work is split the same way whatever the number of threads, and NumPy and the kernels release the interpreter:
the result never depends on how many there are.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from numba import config

THREADS = min(2, int(config.NUMBA_NUM_THREADS))
"""What is used where the caller does not say: one where NUMBA_NUM_THREADS is 1, as beside other processes."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], threads: int = THREADS
) -> Iterator[Result]:
    """Results of `work` in the order of `items`, each as soon as it and those before it are there."""
    with ThreadPoolExecutor(max(1, threads)) as pool:
        yield from pool.map(work, items)


def for_each(work: Callable[[Item], object], items: Iterable[Item], threads: int = THREADS) -> None:
    """Do `work` on every item; returns when all is done, and raises what the first failure raised."""
    deque(in_order(work, items, threads), maxlen=0)
