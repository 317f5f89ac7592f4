"""The registration study as one self-contained page: tables and figures of its trials."""

from __future__ import annotations

import html
from collections.abc import Sequence

from dvf_ig.report.page import html_page, image_tag, section

from .capture import capture_curves, colors_of, error_boxes
from .checks import reliability_figure, roc_figure
from .values import OURS, CapturePage, Group, Limits, Share, Spread, TrialGroup

EXPERIMENTS = {
    "A": "Same image (check of the pipeline)",
    "B": "Simulated ultrasound of the beating heart",
    "C": "Recorded ultrasound and MR",
    "D": "Gating: phase error and heart rate",
    "E": "Few tracked planes, with calibration and lag errors",
    "F": "Detection of failures",
}

_STYLE = """
body { max-width: 1280px; } h3 { font-size: 1rem; margin: 1.2rem 0 0; }
.wide { overflow-x: auto; } table { font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .8rem .25rem .3rem; } td { white-space: nowrap; }
th { vertical-align: bottom; border-bottom: 1px solid #999; max-width: 7.5rem; line-height: 1.25; }
td.n, th.n { text-align: right; } td.label { color: #1c1c1c; } tr.ours td { background: #eef4fa; }
td small, th small { color: #777; font-weight: 400; display: block; }
.pair { display: flex; flex-wrap: wrap; gap: 1rem; margin-top: 1rem; } .pair img { max-width: 560px; }
"""
_LABELS = {"motion": "heart", "quality": "ultrasound", "method": "method", "condition": "condition"}


def capture_html(page: CapturePage) -> str:
    """The page: a table and figures for each experiment, then how failures were detected in all."""
    limits, colors = page.limits, colors_of(page.methods)
    letters = sorted({row.group.experiment for row in page.groups})
    body = "".join(_experiment_section(letter, page, colors) for letter in letters)
    refused = (
        f"<p class=note>{page.refused} more trials were refused and do not say of what kind they were; they "
        "are in no row below.</p>"
        if page.refused
        else ""
    )
    note = (
        f"<p class=note>{sum(row.group.n for row in page.groups)} registrations, dvf_ig {page.version}. Each "
        "begins at a pose a known distance from the truth; its error is the mean distance by which it then "
        f"misplaces points of the heart. It succeeds below {limits.success_mm:.0f} mm and fails above "
        f"{limits.failure_mm:.0f} mm; shares are of all runs, refused ones among them as no successes. "
        "Intervals are Wilson's, and take runs as independent: several share an image pair.</p>"
    )
    title = "Registration of ultrasound to MR from known starts"
    return html_page(title, f"{note}{refused}{body}{_check_section(page, colors)}", style=_STYLE)


def _experiment_section(letter: str, page: CapturePage, colors: dict[str, str]) -> str:
    rows = [row for row in page.groups if row.group.experiment == letter]
    varied = _varied([row.group for row in rows])
    boxes = [
        (" · ".join(filter(None, _labels(row.group, varied))), row.group.method, row.errors_mm)
        for row in rows
    ]
    mine = [curve for curve in page.success if curve.experiment == letter]
    figures = [
        (
            capture_curves(mine, colors, page.limits),
            "Capture range: success by the error of the start",
            f"Dotted: {page.limits.captured_percent:g} %. Bars: 95 % intervals.",
        ),
        (
            error_boxes(boxes, colors, page.limits),
            "Errors",
            "Box: middle half of the runs; whiskers: 5 to 95 %; dots: the other runs.",
        ),
    ]
    name = EXPERIMENTS.get(letter, "")
    heading = f"{letter}: {name}" if name else letter or "Registrations"
    table = _table(
        [*(_LABELS[v] for v in varied)],
        _number_heads(page.limits),
        [(row.group, [*_labels(row.group, varied), *_numbers(row)]) for row in rows],
    )
    return f"<h2>{html.escape(heading)}</h2>{table}" + "".join(
        section(title, note, image_tag(figure, f"{title}, {heading}"), level=3)
        for figure, title, note in figures
        if figure is not None
    )


def _check_section(page: CapturePage, colors: dict[str, str]) -> str:
    groups = [row.group for row in page.groups]
    judged = [g for g in groups if g.check.auc is not None or g.check.released_failures or _flags(g)]
    if not judged:
        return ""
    varied = _varied(judged)
    rows = [(g, [g.experiment, *_labels(g, varied), *_checks(g)]) for g in judged]
    figures = [
        (roc_figure(page.roc, colors, page.limits), "Failures caught against good registrations refused"),
        (
            reliability_figure(page.reliability, colors, page.limits),
            "Stated success probability against the share of successes",
        ),
    ]
    images = "".join(image_tag(figure, title) for figure, title in figures if figure is not None)
    return (
        "<h2>Detection of failed registrations</h2><p class=note>A registration whose checks exceed a limit "
        "releases no pose. Left, ring: the limit in use. Right: whether of runs with a stated probability "
        "of 80 % in truth 80 % succeed (bars: 95 % intervals).</p>"
        f"{_table(['experiment', *(_LABELS[v] for v in varied)], _check_heads(page.limits), rows)}"
        f"<div class=pair>{images}</div>"
    )


def _number_heads(limits: Limits) -> tuple[tuple[str, str], ...]:
    return (
        ("runs", "image pairs"),
        (f"below {limits.success_mm:.0f}\u00a0mm,\u00a0%", "95 % interval"),
        (f"starts ≤\u00a0{limits.near_mm:.0f}\u00a0mm", "95 % interval"),
        (f"<\u00a0{limits.strict_mm:.0f}\u00a0mm, %", ""),
        (f"{limits.success_mm:.0f}\u00a0to\u00a0{limits.failure_mm:.0f}\u00a0mm, %", ""),
        (f">\u00a0{limits.failure_mm:.0f}\u00a0mm, %", ""),
        ("error,\u00a0mm: median", "p95 · largest"),
        ("of successes,\u00a0mm", "p95 · largest"),
        ("rotation,\u00a0°", "p95"),
        ("captures up\u00a0to", f"{limits.captured_percent:g} % succeed"),
        ("time,\u00a0s", "p95"),
    )


def _check_heads(limits: Limits) -> tuple[tuple[str, str], ...]:
    return (
        (f"failures caught, % (above {limits.failure_mm:.0f} mm)", "95 % interval"),
        (f"good ones refused, % (below {limits.success_mm:.0f} mm)", "95 % interval"),
        (f"failures among released poses, % (above {limits.failure_mm:.0f} mm)", "95 % interval"),
        ("area under the ROC", "of the probability"),
    )


def _flags(group: Group) -> bool:
    return group.check.failures_flagged is not None or group.check.successes_flagged is not None


def _varied(groups: Sequence[Group]) -> list[str]:
    """Which of the labels differ between these groups; the method always."""
    return [
        name for name in _LABELS if name == "method" or len({getattr(group, name) for group in groups}) > 1
    ]


def _labels(group: Group, names: Sequence[str]) -> list[str]:
    return [getattr(group, name) for name in names]


def _numbers(row: TrialGroup) -> list[str]:
    group = row.group
    runs = f"{group.n}" + (f" ({group.refused} refused)" if group.refused else "")
    return [
        _cell(runs, f"{group.pairs}"),
        _share(group.success),
        _share(row.near_success),
        _percent(group.strict),
        _percent(group.between),
        _percent(group.failure),
        _spread(group.tre_mm, 2, largest=True),
        _spread(group.success_tre_mm, 2, largest=True),
        _spread(group.rotation_deg, 1),
        str(group.capture),
        _spread(group.seconds, 2),
    ]


def _checks(group: Group) -> list[str]:
    check = group.check
    shares = (check.failures_flagged, check.successes_flagged, check.released_failures)
    return [
        *(_share(share, counted=True) for share in shares),
        "–" if check.auc is None else f"{check.auc:.3f}",
    ]


def _share(share: Share | None, *, counted: bool = False) -> str:
    if share is None or share.low is None or share.high is None:
        return "–"
    of = f" of {share.of}" if counted else ""
    return _cell(_percent(share), f"{100 * share.low:.1f}–{100 * share.high:.1f}{of}")


def _percent(share: Share) -> str:
    return "–" if share.share is None else f"{100 * share.share:.1f}"


def _spread(spread: Spread, digits: int, *, largest: bool = False) -> str:
    if spread.n == 0:
        return "–"
    values = (spread.median, spread.p95, spread.max)
    median, p95, top = ("lost" if value is None else f"{value:.{digits}f}" for value in values)
    return _cell(median, f"{p95} · {top}" if largest else p95)


def _cell(text: str, small: str) -> str:
    return f"{text}\n{small}"


def _table(
    labels: Sequence[str], numbers: Sequence[tuple[str, str]], rows: Sequence[tuple[Group, Sequence[str]]]
) -> str:
    """Cells are text, or text and a small line below."""
    head = "".join(f"<th>{html.escape(label)}</th>" for label in labels)
    head += "".join(f"<th class=n>{_lines(_cell(*number))}</th>" for number in numbers)
    body = ""
    for group, cells in rows:
        body += "<tr class=ours>" if group.method == OURS else "<tr>"
        for place, cell in enumerate(cells):
            body += f"<td class={'label' if place < len(labels) else 'n'}>{_lines(cell)}</td>"
        body += "</tr>"
    return f"<div class=wide><table><tr>{head}</tr>{body}</table></div>"


def _lines(cell: str) -> str:
    text, _, small = cell.partition("\n")
    return html.escape(text) + (f"<small>{html.escape(small)}</small>" if small else "")
