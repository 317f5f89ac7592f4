"""One page of the study of faults: detection, force given in error, recovery, false alarms."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

from matplotlib.figure import Figure

from dvf_ig.report.page import html_page, image_tag, section, table
from dvf_ig.report.style import ESTIMATE, GUIDE, START

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


class SeverityRow(Protocol):
    """See `dvf_ig.study.faults.summary.SeveritySummary`."""

    @property
    def label(self) -> str: ...
    @property
    def limit_s(self) -> float: ...
    @property
    def trials(self) -> int: ...
    @property
    def detected(self) -> int: ...
    @property
    def median_s(self) -> float | None: ...
    @property
    def largest_s(self) -> float | None: ...
    @property
    def error_n(self) -> float | None: ...
    @property
    def error_s(self) -> float | None: ...
    @property
    def recovered(self) -> int: ...
    @property
    def recoverable(self) -> int: ...
    @property
    def latched(self) -> int: ...
    @property
    def recovery_s(self) -> float | None: ...
    @property
    def early(self) -> int: ...
    @property
    def found(self) -> tuple[str, ...]: ...


class FaultRow(Protocol):
    """See `dvf_ig.study.faults.summary.RowSummary`."""

    @property
    def name(self) -> str: ...
    @property
    def limit(self) -> str: ...
    @property
    def severities(self) -> Sequence[SeverityRow]: ...


def faults_page(
    rows: Sequence[FaultRow], counts: Mapping[str, int], raised: Mapping[str, int], hours: float
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


def detection_figure(rows: Sequence[FaultRow]) -> Figure:
    """Times and limits on a logarithmic axis."""
    drawn = [row for row in rows if any(one.limit_s > 0.0 for one in row.severities)]
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


def _cells(row: FaultRow) -> list[tuple[str, ...]]:
    head = (row.name, *("",) * 2, row.limit, *("",) * 5)
    return [head, *(_severity_cells(one) for one in row.severities)]


def _severity_cells(one: SeverityRow) -> tuple[str, ...]:
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
