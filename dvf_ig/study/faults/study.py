"""Put every hazard of the table into the streams, at three severities; count false alarms without a fault.

Session, supervisor and servo are the real ones; images are not made: what they would say about the pose is
known. summary.json: `hazards` rows, `detected` in every trial within their limit, `missed` the others,
`false_alarms` of the clean run; faults.html is the page. The unit is the seed.

    dvf-ig study faults --seeds 20 --hours 8 -o study
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from statistics import median
from typing import TYPE_CHECKING, Any

from dvf_ig.report.page import html_page, image_tag, section, table
from dvf_ig.report.style import ESTIMATE, GUIDE, START
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials
from dvf_ig.study.faults.catalogue import ROWS, SEVERITIES, Row, Severity
from dvf_ig.study.faults.clean import SECONDS, clean_trial
from dvf_ig.study.faults.servo_trial import ServoFault, run_servo_fault
from dvf_ig.study.faults.session_trial import SessionFault, judge, run_session_fault
from dvf_ig.study.faults.start_trial import StartFault, refused
from dvf_ig.study.options import option, seed_option, seeds_option

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class FaultsSettings:
    """Options of the study."""

    seeds: int = seeds_option(20)
    seed: int = seed_option(2001)
    hours: float = option("Simulated hours without a fault.", 8.0, least=0.1)


CASES = SEVERITIES * len(ROWS)
"""Rows times severities: trials of one seed."""


def case_of(number: int) -> tuple[int, Row, Severity]:
    """Seed, row and severity of a trial; those of one seed follow one another."""
    seed, case = divmod(number, CASES)
    row = ROWS[case // SEVERITIES]
    return seed, row, row.severities[case % SEVERITIES]


def trial_numbers(first_seed: int, seeds: int) -> range:
    """Numbers of the trials of consecutive seeds."""
    return range(first_seed * CASES, (first_seed + seeds) * CASES)


def fault_trial(settings: Settings, number: int) -> Line:
    """Run one trial.

    Args:
        settings: none.
        number: see `case_of`.
    """
    seed, row, severity = case_of(number)
    head = {"fault_seed": seed, "row": row.name, "severity": severity.label, "limit_s": severity.limit_s}
    if isinstance(severity.fault, StartFault):
        refusal = refused(severity.fault.start, seed)
        return {
            **head,
            "detected": refusal,
            "detected_s": 0.0 if refusal else None,
            "early": refused(severity.fault.clean, seed),
            "found": [],
        }
    return {**head, **_judged(row, severity, severity.fault, seed)}


def _judged(row: Row, severity: Severity, fault: SessionFault | ServoFault, seed: int) -> Line:
    run = run_session_fault(fault, seed) if isinstance(fault, SessionFault) else run_servo_fault(fault, seed)
    judgement = judge(
        run.trace,
        row.hazards,
        begin_s=run.begin_s,
        end_s=run.end_s,
        limit_s=severity.limit_s,
        rearm_s=run.rearm_s,
        by_pose=isinstance(fault, SessionFault) and fault.by_pose,
    )
    stays, back_s = isinstance(fault, ServoFault) and fault.restarts, judgement.recovery_s
    return {
        "detected": judgement.detected_s <= severity.limit_s + 1e-9,
        "detected_s": judgement.detected_s if isfinite(judgement.detected_s) else None,
        "early": judgement.early,
        "found": [str(hazard.name) for hazard in judgement.found],
        "error_n": judgement.error_n,
        "error_s": judgement.error_s,
        "latched": judgement.latched,
        "recovery_s": None if back_s is None or not isfinite(back_s) else back_s,
        "recovered": back_s is not None and not judgement.recovered if stays else judgement.recovered,
    }


@dataclass(frozen=True, slots=True)
class SeveritySummary:
    """One severity of a row over its seeds.

    Attributes:
        label: of the severity; limit_s: within which it must be detected.
        trials: that were run; detected: within the limit; late: detected after it.
        median_s, largest_s: time to detection; None if there was none.
        error_n, error_s: largest force in error, and longest time above 0.05 N; None if the rule lets it be.
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


SHOWN_LEAST_S = 1e-4
"""Detections at once are drawn here: the axis is logarithmic."""
HEADING = (
    "hazard and severity",
    "detected",
    "time to detection: median, largest",
    "limit",
    "force in error",
    "for",
    "back as the rule says",
    "back after",
    "raised",
)


def faults_page(
    rows: Sequence[RowSummary], counts: Mapping[str, int], raised: Mapping[str, int], hours: float
) -> str:
    """The page.

    Args:
        rows: of the table.
        counts: `hazards`, `detected`, `missed`, `false_alarms`.
        raised: in the clean interventions, by hazard; hours: simulated.
    """
    good = counts["missed"] == 0 and counts["false_alarms"] <= 1
    verdict = (
        f"{counts['detected']} of {counts['hazards']} rows detected within their limit in every trial, "
        f"{counts['false_alarms']} false alarms in {hours:.1f} h"
    )
    body = f"<p><span class='verdict {'good' if good else 'bad'}'>{verdict}</span></p>"
    body += section(
        "Time to detection against its limit",
        "Dots: median and largest over the seeds, three severities a row, the least on top; bars: the limit. "
        "Detection at once is drawn at 0.1 ms. Rows that a start refuses are not drawn.",
        image_tag(detection_figure(rows), "time to detection against its limit"),
    )
    body += section(
        "Every row",
        "Force in error: the largest force sent after limit and fade while the fault lasted, and for how "
        "long it was above 0.05 N; – where the rule lets the force be. Back: after the fault's end, or after "
        "the re-arm where the supervisor latched. Early: raised, or refused, without the fault.",
        table(HEADING, [cells for row in rows for cells in _cells(row)]),
    )
    body += section(
        "Clean interventions",
        f"{hours:.1f} simulated hours without a fault. POSE_MOVING is normal work: beats move the pose by a "
        "tenth of a millimetre.",
        table(("hazard", "times raised"), [(name, str(count)) for name, count in raised.items()]),
    )
    return html_page("Faults: what is detected, and what the force does", body)


def detection_figure(rows: Sequence[RowSummary]) -> Figure:
    """Times and limits on a logarithmic axis."""
    drawn = [row for row in rows if any(one.limit_s > 0.0 for one in row.severities)]
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 0.34 * len(drawn) + 1.4), layout="constrained")
    axis = figure.subplots()
    for k, row in enumerate(drawn):
        for j, one in enumerate(row.severities):
            y = k + 0.26 * (j - 1)
            axis.plot([SHOWN_LEAST_S, one.limit_s], [y, y], color=GUIDE, lw=4.0, alpha=0.25)
            for value, fill in ((one.median_s, ESTIMATE), (one.largest_s, "white")):
                if value is not None:
                    late = value > one.limit_s + 1e-9
                    color = START if late else ESTIMATE
                    at = max(value, SHOWN_LEAST_S)
                    face = color if fill != "white" else fill
                    axis.plot(at, y, "o", ms=4.0, mec=color, mfc=face)
    axis.set(xscale="log", ylim=(len(drawn) - 0.4, -0.6), xlabel="s after the fault began")
    axis.set_yticks(range(len(drawn)), [row.name for row in drawn])
    axis.grid(axis="x", alpha=0.25, lw=0.5)
    return figure


def _cells(row: RowSummary) -> list[tuple[str, ...]]:
    head = (row.name, *("",) * 2, row.limit, *("",) * 5)
    return [head, *(_severity_cells(one) for one in row.severities)]


def _severity_cells(one: SeveritySummary) -> tuple[str, ...]:
    early = f", {one.early} early" if one.early else ""
    latched = " (re-armed)" if one.latched == one.trials else ""
    return (
        f"· {one.label}",
        f"{one.detected} of {one.trials}{early}",
        f"{shown_s(one.median_s)}, {shown_s(one.largest_s)}",
        shown_s(one.limit_s),
        "–" if one.error_n is None else f"{one.error_n:.2f} N",
        "–" if one.error_s is None else shown_s(one.error_s),
        f"{one.recovered} of {one.recoverable}{latched}" if one.recoverable else "–",
        shown_s(one.recovery_s),
        ", ".join(one.found) or "refused",
    )


def shown_s(seconds: float | None) -> str:
    """A time in ms below 1 s."""
    if seconds is None or not math.isfinite(seconds):
        return "–"
    return f"{1000 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.2f} s"


def run(settings: FaultsSettings, driver: Driver) -> Result:
    """Run every fault on every seed, and the clean interventions."""
    clean_seeds = range(settings.seed, settings.seed + math.ceil(settings.hours * 3600.0 / SECONDS))
    numbers = trial_numbers(settings.seed, settings.seeds)
    lines = driver.trials(Trials("faults", {}, fault_trial), numbers, group_size=CASES)
    quiet = driver.trials(Trials("clean interventions", {}, clean_trial), clean_seeds, below="clean")
    rows, clean = summarise_faults(lines), summarise_clean(quiet)
    counts = {**table_counts(rows), "false_alarms": clean.false_alarms}
    summary = {**counts, "seed": settings.seed, "seeds": settings.seeds, "clean": clean, "rows": rows}
    page = faults_page(rows, counts, clean.raised, clean.hours)
    return Result(summary, _table(rows), {"summary.json": summary, "faults.html": page})


def _table(rows: Sequence[RowSummary]) -> Rows:
    head = ("hazard", "severity", "detected", "median, largest", "limit", "force in error", "back")
    return [head, *(_printed(row, one) for row in rows for one in row.severities)]


def _printed(row: RowSummary, one: SeveritySummary) -> tuple[str, ...]:
    return (
        row.name,
        one.label,
        f"{one.detected} of {one.trials}",
        f"{shown_s(one.median_s)}, {shown_s(one.largest_s)}",
        shown_s(one.limit_s),
        "" if one.error_n is None else f"{one.error_n:.2f} N for {shown_s(one.error_s)}",
        f"{one.recovered} of {one.recoverable}" if one.recoverable else "",
    )


STUDY = Study(FaultsSettings, run, outputs=lambda _: ("summary.json", "faults.html"))
