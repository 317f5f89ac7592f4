"""What the trials say together: each row at each severity, and the table as a whole."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from dvf_ig.study.trials import Line

from .catalogue import ROWS
from .rows.row import Severity


@dataclass(frozen=True, slots=True)
class SeveritySummary:
    """One severity of a row over its seeds.

    Attributes:
        label: of the severity; limit_s: within which it must be detected.
        trials: that were run; detected: within the limit; late: detected after it.
        median_s, largest_s: time to detection; None where there was none.
        error_n, error_s: largest force in error, and longest time above 0.05 N; None where the rule gives it.
        recovered: trials in which the force came back as the rule says; of `recoverable`.
        latched: trials in which it had to be re-armed.
        recovery_s: median time from the fault's end, or the re-arm, until the force was back.
        early: trials in which something was raised, or refused, without the fault.
        found: hazards that were raised.
    """

    label: str
    limit_s: float
    trials: int
    detected: int
    late: int
    median_s: float | None
    largest_s: float | None
    error_n: float | None
    error_s: float | None
    recovered: int
    recoverable: int
    latched: int
    recovery_s: float | None
    early: int
    found: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RowSummary:
    """One row.

    Attributes:
        name, limit: of the row.
        severities: three, the least first.
    """

    name: str
    limit: str
    severities: tuple[SeveritySummary, ...]

    @property
    def detected(self) -> bool:
        """Every trial within its limit."""
        return all(one.detected == one.trials for one in self.severities)


def summarise_faults(lines: Sequence[Line]) -> list[RowSummary]:
    """Rows of the table that were run, in its order."""
    rows = []
    for row in ROWS:
        mine = [line for line in lines if line.get("row") == row.name]
        if mine:
            rows.append(RowSummary(row.name, row.limit, tuple(_severity(s, mine) for s in row.severities)))
    return rows


def table_counts(rows: Sequence[RowSummary]) -> dict[str, int]:
    """`hazards` rows, of which `detected` in every trial within its limit; `missed` the others."""
    detected = sum(row.detected for row in rows)
    return {"hazards": len(rows), "detected": detected, "missed": len(rows) - detected}


def _severity(severity: Severity, lines: Sequence[Line]) -> SeveritySummary:
    mine = [line for line in lines if line["severity"] == severity.label]
    times = _known(mine, "detected_s")
    back = [line for line in mine if "recovered" in line]
    return SeveritySummary(
        label=severity.label,
        limit_s=severity.limit_s,
        trials=len(mine),
        detected=sum(line["detected"] for line in mine),
        late=sum(not line["detected"] for line in mine if line["detected_s"] is not None),
        median_s=median(times) if times else None,
        largest_s=max(times, default=None),
        error_n=max(_known(mine, "error_n"), default=None),
        error_s=max(_known(mine, "error_s"), default=None),
        recovered=sum(line["recovered"] for line in back),
        recoverable=len(back),
        latched=sum(line["latched"] for line in back),
        recovery_s=median(_known(mine, "recovery_s")) if _known(mine, "recovery_s") else None,
        early=sum(line["early"] for line in mine),
        found=tuple(sorted({name for line in mine for name in line["found"]})),
    )


def _known(lines: Sequence[Line], name: str) -> list[Any]:
    return [line[name] for line in lines if line.get(name) is not None]


@dataclass(frozen=True, slots=True)
class CleanSummary:
    """Interventions without a fault.

    Attributes:
        hours: simulated.
        false_alarms: hazards that were raised once guidance had begun, of session or servo alone.
        raised: by hazard, how often it began, those of normal work included.
        served_share: of the states after the start, those with the force given in full.
    """

    hours: float
    false_alarms: int
    raised: dict[str, int]
    served_share: float


def summarise_clean(lines: Sequence[Line]) -> CleanSummary:
    """All interventions together."""
    raised: dict[str, int] = {}
    for line in lines:
        for name, count in (*line["session"].items(), *line["servo"].items()):
            raised[name] = raised.get(name, 0) + count
    return CleanSummary(
        hours=sum(line["hours"] for line in lines),
        false_alarms=sum(line["false_alarms"] for line in lines),
        raised=dict(sorted(raised.items())),
        served_share=sum(line["served_share"] for line in lines) / max(1, len(lines)),
    )
