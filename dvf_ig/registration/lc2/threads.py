"""The threads that LC2 of many slices is shared among; who makes them closes them."""

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

from dvf_ig.kernels.compiled import thread_count


class SliceThreads:
    """Runs a kernel over slices, an equal share of them on each thread, the caller's own among them.

    A context manager: its threads end with it, and what outlives it runs on the caller's thread. Kernels
    write one row a slice, so results do not depend on the number of threads.
    """

    def __init__(self) -> None:
        self.count = thread_count()
        self._pool = ThreadPoolExecutor(max(1, self.count - 1))

    def __enter__(self) -> "SliceThreads":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.shutdown()
        self.count = 1

    def run(self, work: Callable[[int, int, int], object], items: int) -> None:
        """work(worker, begin, end) over 0 <= item < `items`, in a range for each thread."""
        count = max(1, min(self.count, items))
        limits = [round(k * items / count) for k in range(count + 1)]
        own, *others = enumerate(itertools.pairwise(limits))
        running = [self._pool.submit(work, worker, *share) for worker, share in others]
        work(own[0], *own[1])
        for share in running:
            share.result()
