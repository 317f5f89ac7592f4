"""Mean and spread of calibration errors, of all of them and as PLUS reports them."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray

LOWEST_SHARE = 0.95
"""Share of the smallest errors behind `mean95_mm`, the convention in which PLUS reports."""


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Attributes:
    mean_mm, sd_mm: over all errors.
    mean95_mm, sd95_mm: over the lowest 95 % of them.
    """

    mean_mm: float
    sd_mm: float
    mean95_mm: float
    sd95_mm: float


def summarise(errors_mm: FloatArray) -> ErrorSummary:
    """Summary of (n,) errors, n >= 1; the SD of a single one is 0."""
    increasing = np.sort(errors_mm)
    lowest = increasing[: max(1, int(np.floor(LOWEST_SHARE * len(increasing))))]
    return ErrorSummary(float(increasing.mean()), _sd(increasing), float(lowest.mean()), _sd(lowest))


def _sd(values: FloatArray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else 0.0
