"""What the page of the registration study is made from: groups of trials, and the curves of its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from dvf_ig.core.arrays import FloatArray, read_only_arrays

OURS = "dvf_ig"
"""Name of this package's own method; it comes first and in blue."""


class Share(Protocol):
    """A share of `of` runs with its Wilson 95 % interval, 0 to 1; None of nothing."""

    @property
    def of(self) -> int: ...
    @property
    def share(self) -> float | None: ...
    @property
    def low(self) -> float | None: ...
    @property
    def high(self) -> float | None: ...


class Spread(Protocol):
    """Percentiles of `n` values; None where runs without a finite error reach down to that percentile."""

    @property
    def n(self) -> int: ...
    @property
    def median(self) -> float | None: ...
    @property
    def p95(self) -> float | None: ...
    @property
    def max(self) -> float | None: ...


class Bin(Protocol):
    """Successes of the starts between two start errors."""

    @property
    def low_mm(self) -> float: ...
    @property
    def high_mm(self) -> float: ...
    @property
    def success(self) -> Share: ...


class SelfCheck(Protocol):
    """Detection of a method's own failures; None where it does not judge itself."""

    @property
    def failures_flagged(self) -> Share | None: ...
    @property
    def successes_flagged(self) -> Share | None: ...
    @property
    def released_failures(self) -> Share | None: ...
    @property
    def auc(self) -> float | None: ...


class Group(Protocol):
    """The runs of one experiment, motion, quality, method and condition: numbers, shares and spreads."""

    @property
    def experiment(self) -> str: ...
    @property
    def motion(self) -> str: ...
    @property
    def quality(self) -> str: ...
    @property
    def method(self) -> str: ...
    @property
    def condition(self) -> str: ...
    @property
    def pairs(self) -> int: ...
    @property
    def n(self) -> int: ...
    @property
    def refused(self) -> int: ...
    @property
    def tre_mm(self) -> Spread: ...
    @property
    def success_tre_mm(self) -> Spread: ...
    @property
    def rotation_deg(self) -> Spread: ...
    @property
    def success(self) -> Share: ...
    @property
    def strict(self) -> Share: ...
    @property
    def between(self) -> Share: ...
    @property
    def failure(self) -> Share: ...
    @property
    def capture(self) -> object: ...
    @property
    def seconds(self) -> Spread: ...
    @property
    def check(self) -> SelfCheck: ...


@dataclass(frozen=True, slots=True)
class Limits:
    """Errors that divide runs, and the share from which a start counts as captured.

    Attributes:
        strict_mm, success_mm, failure_mm: a strict success is below the first, a success below the second, a
            failure above the third.
        near_mm: starts up to here have a column of their own.
        bin_mm: width of the bins of start error.
        captured_percent: a start is captured where at least so many of the runs succeed.
    """

    strict_mm: float
    success_mm: float
    failure_mm: float
    near_mm: float
    bin_mm: float
    captured_percent: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrialGroup:
    """A row of the table and a box of the errors.

    Attributes:
        group: all its runs.
        near_success: successes of the starts within `Limits.near_mm`; None without any.
        errors_mm: (k,) of the runs that were not refused; infinite where a run ended without an error.
    """

    group: Group
    near_success: Share | None
    errors_mm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SuccessCurve:
    """Success by start error of one experiment, method, quality and condition; `bins` may be empty."""

    experiment: str
    method: str
    quality: str
    condition: str
    bins: Sequence[Bin]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RocCurve:
    """Failures caught against good registrations refused, for every limit of the success probability.

    Attributes:
        method: whose.
        refused_percent, caught_percent: (k,) of the good ones, of the failures.
        area: under the curve, 0 to 1.
        failures: how many there are.
        chosen_percent: refused and caught where the method itself draws the line; None where it does not.
    """

    method: str
    refused_percent: FloatArray
    caught_percent: FloatArray
    area: float
    failures: int
    chosen_percent: tuple[float, float] | None


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """Stated success probability against the share of successes.

    Attributes:
        method: whose.
        stated: (n,) probability of each run, 0 to 1.
        mean_stated: (t,) mean of each tenth of the scale that was stated at all.
        success: (t,) share of successes among those runs.
    """

    method: str
    stated: FloatArray
    mean_stated: FloatArray
    success: tuple[Share, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CapturePage:
    """Everything on the page.

    Attributes:
        version: of the package.
        limits: what divides runs.
        methods: ours first.
        groups: rows, in order.
        refused: trials that were refused and do not say of what kind they were; they are in no group.
        success, roc, reliability: curves of the figures.
    """

    version: str
    limits: Limits
    methods: tuple[str, ...]
    groups: tuple[TrialGroup, ...]
    refused: int
    success: tuple[SuccessCurve, ...]
    roc: tuple[RocCurve, ...]
    reliability: tuple[Reliability, ...]
