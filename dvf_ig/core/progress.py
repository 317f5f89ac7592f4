"""How long work tells how far it is."""

from collections.abc import Callable

Progress = Callable[[float], None]
"""Told the share of the work that is done, 0 to 1."""


def part_of(progress: Progress, k: int, parts: int) -> Progress:
    """What part `k` of equally long ones tells, so that `progress` is told the share of the whole."""
    return lambda share: progress((k + share) / parts)


def untold(_: float) -> None:
    """Nobody is told."""
