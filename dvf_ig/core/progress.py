"""Progress callbacks of long computations."""

from collections.abc import Callable

Progress = Callable[[float], None]
"""Callback called with the fraction of the work done, 0 to 1."""


def part_of(progress: Progress, k: int, parts: int) -> Progress:
    """Return the callback of part `k` of equal `parts`, which calls `progress` with the overall fraction."""
    return lambda share: progress((k + share) / parts)


def untold(_: float) -> None:
    """Ignore progress."""
