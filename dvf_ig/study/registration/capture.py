"""Capture range: how far from the truth a registration may start and still succeed."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from dvf_ig.study.share import Share, share_of
from dvf_ig.study.trials import Line

from .experiments import BIN_MM
from .line import SUCCESS_MM, error_of, number

CAPTURE_PERCENT = 95
"""The capture range reaches as far as at least so many of the runs succeed."""


@dataclass(frozen=True, slots=True)
class Bin:
    """Successes of the starts above `low_mm` (from it, if 0) up to `high_mm`."""

    low_mm: float
    high_mm: float
    success: Share


@dataclass(frozen=True, slots=True)
class Capture:
    """Capture range.

    Attributes:
        range_mm: lower edge of the first bin with less than 95 % success. If none has less, the upper edge
            of the last bin before a gap; None without starts.
        at_least: no bin had less; the range may be longer.
        bins: those with starts, by start.
    """

    range_mm: float | None
    at_least: bool
    bins: tuple[Bin, ...]

    def __str__(self) -> str:
        if self.range_mm is None:
            return "–"
        return f"{'≥ ' if self.at_least else ''}{self.range_mm:.0f} mm"


def capture_of(lines: Iterable[Line]) -> Capture:
    """Success by start error, and how far it reaches. Refused runs are no successes."""
    counts: dict[int, list[bool]] = {}
    for line in lines:
        start = number(line, "start_mm")
        if math.isfinite(start):
            # starts are scaled to their error, which may miss a bin's edge by a rounding
            place = max(0, math.ceil(round(start, 6) / BIN_MM) - 1)
            counts.setdefault(place, []).append(error_of(line) < SUCCESS_MM)
    bins = tuple(
        Bin(BIN_MM * place, BIN_MM * (place + 1), share_of(sum(counts[place]), len(counts[place])))
        for place in sorted(counts)
    )
    reached = None
    for entry in bins:
        if reached is not None and entry.low_mm > reached:
            break
        if 100 * entry.success.count < CAPTURE_PERCENT * entry.success.of:
            return Capture(entry.low_mm, at_least=False, bins=bins)
        reached = entry.high_mm
    return Capture(reached, at_least=reached is not None, bins=bins)
