"""Mean, spread and quantiles of a set of errors: the summary of every accuracy in this project."""

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray
from .errors import InvalidInputError

LOWEST_SHARE = 0.95
"""Share of the smallest errors behind `mean95` and `sd95`, the convention in which PLUS reports."""


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Summary of n errors, in their unit.

    Attributes:
        mean, sd: over all errors; the SD divides by n - 1 and is 0 for a single error.
        median, p95, max: quantiles of all errors.
        n: number of errors.
        mean95, sd95: over the lowest 95 % of the errors.
    """

    mean: float
    sd: float
    median: float
    p95: float
    max: float
    n: int
    mean95: float
    sd95: float

    def tre_fields(self) -> dict[str, float | int]:
        """Return mean, median, p95, max and n: the fields in which a target registration error is written."""
        return {"mean": self.mean, "median": self.median, "p95": self.p95, "max": self.max, "n": self.n}


def summarise_errors(errors: FloatArray) -> ErrorSummary:
    """Summarise (n,) errors, n >= 1.

    Raises:
        InvalidInputError: no error given.
    """
    if len(errors) == 0:
        raise InvalidInputError("no errors to summarise; needed at least one")
    lowest = np.sort(errors)[: max(1, int(np.floor(LOWEST_SHARE * len(errors))))]
    return ErrorSummary(
        mean=float(errors.mean()),
        sd=_sd(errors),
        median=float(np.median(errors)),
        p95=float(np.percentile(errors, 95)),
        max=float(errors.max()),
        n=len(errors),
        mean95=float(lowest.mean()),
        sd95=_sd(lowest),
    )


def _sd(values: FloatArray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else 0.0
