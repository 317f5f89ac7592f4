"""The capture study as one self-contained page: tables and pictures of its trials."""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path

import dvf_ig
from dvf_ig.io import write_text
from dvf_ig.replay.report import STYLE, image_tag
from dvf_ig.study.registration.summary import (
    FAILURE_MM,
    STRICT_MM,
    SUCCESS_MM,
    Group,
    Share,
    Spread,
    group_key,
    summarise_trials,
)
from dvf_ig.study.trials import Line

from .registration_capture import OURS, capture_curves, colors_of, error_boxes
from .registration_checks import calibration_picture, roc_picture

NEAR_MM = 12.0
"""Starts up to here have a column of their own: what a registration is given after touched landmarks."""

ARMS = {
    "A": "Same image (check of the harness)",
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
_NUMBERS = (
    ("runs", "image pairs"),
    (f"below {SUCCESS_MM:.0f}\u00a0mm,\u00a0%", "95 % interval"),
    (f"starts ≤\u00a0{NEAR_MM:.0f}\u00a0mm", "95 % interval"),
    (f"<\u00a0{STRICT_MM:.0f}\u00a0mm, %", ""),
    (f"{SUCCESS_MM:.0f}\u00a0to\u00a0{FAILURE_MM:.0f}\u00a0mm, %", ""),
    (f">\u00a0{FAILURE_MM:.0f}\u00a0mm, %", ""),
    ("error,\u00a0mm: median", "p95 · largest"),
    ("of successes,\u00a0mm", "p95 · largest"),
    ("rotation,\u00a0°", "p95"),
    ("captures up\u00a0to", "95 % succeed"),
    ("time,\u00a0s", "p95"),
)
_CHECKS = (
    (f"failures caught, % (above {FAILURE_MM:.0f} mm)", "95 % interval"),
    (f"good ones refused, % (below {SUCCESS_MM:.0f} mm)", "95 % interval"),
    (f"failures among released poses, % (above {FAILURE_MM:.0f} mm)", "95 % interval"),
    ("area under the ROC", "of the probability"),
)


def write_capture_page(lines: Iterable[Line], path: Path) -> None:
    """Write the page of these trials: a table and pictures for each arm, then the self-check of all.

    Raises:
        OutputError: `path` cannot be written.
    """
    write_text(path, capture_html(list(lines)))


def capture_html(lines: Sequence[Line]) -> str:
    """The page; see write_capture_page."""
    groups = summarise_trials(lines)
    near = {_key(group): group for group in summarise_trials(lines, up_to_mm=NEAR_MM)}
    unknown = [group for group in groups if not group.method]
    known = [group for group in groups if group.method]
    arms = sorted({group.experiment for group in known})
    colors = colors_of(lines)
    body = "".join(
        _arm_section(arm, [g for g in known if g.experiment == arm], near, lines, colors) for arm in arms
    )
    refused = sum(group.n for group in unknown)
    lost = (
        f"<p class=note>{refused} more trials were refused and do not say of what kind they were; they "
        "are in no row below.</p>"
        if refused
        else ""
    )
    title = "Registration of ultrasound to MR from known starts"
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title>"
        f"<style>{STYLE}{_STYLE}</style><h1>{title}</h1>"
        f"<p class=note>{sum(g.n for g in known)} registrations, dvf_ig {dvf_ig.__version__}. Each begins at "
        "a pose a known distance from the truth; its error is the mean distance by which it then misplaces "
        f"points of the heart. It succeeds below {SUCCESS_MM:.0f} mm and fails above {FAILURE_MM:.0f} mm; "
        "shares are of all runs, refused ones among them as no successes. Intervals are Wilson's, and take "
        "runs as independent: several share an image pair.</p>"
        f"{lost}{body}{_check_section(known, lines, colors)}</html>\n"
    )


def _arm_section(
    arm: str,
    groups: Sequence[Group],
    near: dict[tuple[str, ...], Group],
    lines: Sequence[Line],
    colors: dict[str, str],
) -> str:
    runs = [line for line in lines if line.get("method") and group_key(line)[0] == arm]
    varied = _varied(groups)
    rows = [(group, [*_labels(group, varied), *_numbers(group, near.get(_key(group)))]) for group in groups]
    boxes = [
        (" · ".join(filter(None, _labels(group, varied))), [r for r in runs if group_key(r) == _key(group)])
        for group in groups
    ]
    curves, errors = capture_curves(runs, colors), error_boxes(boxes, colors)
    pictures = [
        (curves, "Capture: how far off a start may be", "Dotted: 95 %. Bars: 95 % intervals."),
        (errors, "Errors", "Box: middle half of the runs; whiskers: 5 to 95 %; dots: the other runs."),
    ]
    name = ARMS.get(arm, "")
    heading = f"{arm}: {name}" if name else arm or "Registrations"
    return (
        f"<h2>{html.escape(heading)}</h2>{_table([*(_LABELS[v] for v in varied)], _NUMBERS, rows)}"
        + "".join(
            f"<h3>{title}</h3><p class=note>{note}</p>{image_tag(figure, f'{title}, {heading}')}"
            for figure, title, note in pictures
            if figure is not None
        )
    )


def _check_section(groups: Sequence[Group], lines: Sequence[Line], colors: dict[str, str]) -> str:
    telling = [g for g in groups if g.check.auc is not None or g.check.released_failures or _flags(g)]
    if not telling:
        return ""
    labels = ["arm", *_varied(telling)]
    rows = [(g, [g.experiment, *_labels(g, labels[1:]), *_checks(g)]) for g in telling]
    figures = [
        (roc_picture(lines, colors), "Failures caught against good registrations refused"),
        (calibration_picture(lines, colors), "Success probability against what came out"),
    ]
    images = "".join(image_tag(figure, title) for figure, title in figures if figure is not None)
    heads = [_LABELS.get(label, label) for label in labels]
    return (
        "<h2>Does a registration know when it failed?</h2><p class=note>A registration that is not sure of "
        "itself releases no pose. Left, ring: where it draws the line. Right: whether a probability of 80 % "
        "comes true in 80 % of the runs (bars: 95 % intervals).</p>"
        f"{_table(heads, _CHECKS, rows)}<div class=pair>{images}</div>"
    )


def _flags(group: Group) -> bool:
    return group.check.failures_flagged is not None or group.check.successes_flagged is not None


def _key(group: Group) -> tuple[str, ...]:
    return (group.experiment, group.motion, group.quality, group.method, group.condition)


def _varied(groups: Sequence[Group]) -> list[str]:
    """Which of the labels tell these groups apart; the method always."""
    return [
        name for name in _LABELS if name == "method" or len({getattr(group, name) for group in groups}) > 1
    ]


def _labels(group: Group, names: Sequence[str]) -> list[str]:
    return [getattr(group, name) for name in names]


def _numbers(group: Group, near: Group | None) -> list[str]:
    runs = f"{group.n}" + (f" ({group.refused} refused)" if group.refused else "")
    return [
        _cell(runs, f"{group.pairs}"),
        _share(group.success),
        _share(near.success) if near else "–",
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
