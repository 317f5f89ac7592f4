"""Progress of a study that goes through several hearts, one after the other."""

from collections.abc import Callable

Progress = Callable[[float], None]
"""Told the share of the work that is done."""


def part_of(progress: Progress, k: int, parts: int) -> Progress:
    """What part `k` of equally long ones tells, so that `progress` is told the share of the whole."""
    return lambda share: progress((k + share) / parts)
