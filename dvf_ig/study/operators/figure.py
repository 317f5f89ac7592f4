"""Figure of a task: one operator over time, all operators in pairs, the ablations of cutting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.report.style import ESTIMATE, FAINT, GUIDE, SERIES, START, SUSPENDED, TRUTH, open_frame
from dvf_ig.study.driver import Line
from dvf_ig.study.operators import paper
from dvf_ig.study.operators.closed_loop import (
    ABLATIONS,
    HEART_SEED,
    TASKS,
    Condition,
    moving_line,
    operating_heart,
    surface_of,
)
from dvf_ig.study.operators.lesion import MARGIN_MM, ablate
from dvf_ig.study.operators.pellets import DEPTH_MM, cut, dissect
from dvf_ig.study.operators.summary import OperatorsSummary, difference
from dvf_ig.study.operators.tasks import track, tracked_place
from dvf_ig.study.statistics import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLORS = (START, ESTIMATE, SERIES[2])
"""Without force, with it, with it and not attended to."""
WIDTH_IN = 12.5


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Depth of one operator's tip over time.

    Attributes:
        kind: of the condition, a place in `COLORS`; None: the true surface, for comparison.
        t_s, depth_mm: (n,) depth, positive towards the inside.
    """

    kind: int | None
    t_s: FloatArray
    depth_mm: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """One measure of all operators under conditions that belong together.

    Attributes:
        group: what they share, for example the heart; printed below, with what is to be said of it.
        values: (conditions, operators), in the order of `COLORS`.
    """

    group: str
    values: FloatArray


@dataclass(frozen=True, slots=True)
class Panel:
    """Compared conditions of one measure.

    Attributes:
        label: of the measure, with its unit; paper: values of the paper and what they are.
        compared: side by side.
    """

    label: str
    compared: Sequence[Compared]
    paper: Sequence[tuple[float, str]] = ()


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean with its 95 % interval."""

    name: str
    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class OperatorsFigure:
    """Content of the figure.

    Attributes:
        title, note: above and below; the note states the most important assumptions.
        courses: curves side by side, each set under its title.
        ordinate: label of the upper axes; depth_limits_mm: of these, shallow to deep.
        forbidden_mm: what lies deeper is forbidden, and shaded; None: nothing is.
        kinds: names of the conditions in the order of `COLORS`.
        panels: comparisons of all operators.
        ablations: means of `ablation_label`; empty: none are drawn.
    """

    title: str
    note: str
    courses: Sequence[tuple[str, Sequence[Curve]]]
    ordinate: str
    depth_limits_mm: tuple[float, float]
    forbidden_mm: float | None
    kinds: tuple[str, ...]
    panels: Sequence[Panel]
    ablations: Sequence[Interval] = ()
    ablation_label: str = ""


def operators_figure(shown: OperatorsFigure) -> Figure:
    """Above, one operator over time; below, every operator under every condition, and ablations."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, 9.0), layout="constrained")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.0, 1.15))[:, 0].tolist()
    courses = above.subplots(1, len(shown.courses), sharey=True, squeeze=False)[0]
    for axis, (title, curves) in zip(courses, shown.courses, strict=True):
        _draw_course(axis, title, curves, shown)
    courses[0].set(ylabel=shown.ordinate)
    widths = [float(len(panel.compared)) for panel in shown.panels]
    if shown.ablations:
        widths.append(3.2)
    axes = below.subplots(1, len(widths), width_ratios=widths, squeeze=False)[0]
    for axis, panel in zip(axes, shown.panels, strict=False):
        _draw_panel(axis, panel)
    if shown.ablations:
        _draw_ablations(axes[-1], shown.ablations, shown.ablation_label)
    marks = [
        axes[0].plot([], [], "o", color=color, label=name)[0]
        for color, name in zip(COLORS, shown.kinds, strict=False)
    ]
    above.legend(handles=marks, loc="outside upper center", ncols=len(marks), frameon=False, fontsize=10)
    figure.suptitle(shown.title, fontsize=13)
    figure.supxlabel(fill(shown.note, 185), fontsize=8, color=GUIDE)
    return figure


def _draw_course(axis: Axes, title: str, curves: Sequence[Curve], shown: OperatorsFigure) -> None:
    shallow, deep = shown.depth_limits_mm
    if shown.forbidden_mm is not None:
        axis.axhspan(shown.forbidden_mm, deep, color=SUSPENDED, lw=0)
        axis.axhline(shown.forbidden_mm, color=TRUTH, lw=1.0)
        axis.annotate("forbidden", (0.99, 0.03), xycoords="axes fraction", ha="right", fontsize=9)
    for curve in curves:
        if curve.kind is None:
            axis.plot(curve.t_s, curve.depth_mm, color=TRUTH, lw=4.0, alpha=0.3)
        else:
            axis.plot(curve.t_s, curve.depth_mm, color=COLORS[curve.kind], lw=1.3)
    axis.set(ylim=(deep, shallow), xlabel="time, s", title=title)
    axis.title.set_fontsize(10)
    axis.margins(x=0.0)
    open_frame(axis)


def _draw_panel(axis: Axes, panel: Panel) -> None:
    """A line an operator, the mean of all with its interval."""
    rng = np.random.default_rng(0)
    begin, middles = 0.0, []
    for compared in panel.compared:
        count, operators = compared.values.shape
        x = begin + np.arange(count)
        jitter = rng.uniform(-0.10, 0.10, operators)
        axis.plot(x[:, None] + jitter, compared.values, color=FAINT, lw=0.6, zorder=1)
        for i, color in zip(range(count), COLORS, strict=False):
            axis.plot(
                x[i] + jitter,
                compared.values[i],
                "o",
                ms=3.5,
                color=color,
                alpha=0.55,
                zorder=2,
                clip_on=False,
            )
            axis.plot(x[i] + 0.28, compared.values[i].mean(), "_", ms=16, mew=2.5, color=color, zorder=3)
        middles.append(float(x.mean()))
        begin += count + 0.8
    for value, name in panel.paper:
        axis.axhline(value, color=TRUTH, lw=0.9, ls="-.")
        axis.annotate(name, (0.99, value), xycoords=("axes fraction", "data"), textcoords="offset points",
                      xytext=(0, 2), ha="right", fontsize=8)  # fmt: skip
    axis.set(title=panel.label, xlim=(-0.6, begin - 1.2), ylim=(0.0, None))
    axis.set_xticks(middles, [compared.group for compared in panel.compared])
    axis.tick_params(axis="x", length=0)
    axis.title.set_fontsize(10)
    open_frame(axis)


def _draw_ablations(axis: Axes, ablations: Sequence[Interval], label: str) -> None:
    y = np.arange(len(ablations))
    value = np.array([a.value for a in ablations])
    reach = np.array([[a.value - a.low, a.high - a.value] for a in ablations]).T
    axis.errorbar(value, y, xerr=np.maximum(reach, 0.0), fmt="o", ms=5, color=TRUTH, ecolor=GUIDE, capsize=2)
    for i, color in zip(range(len(ablations)), COLORS, strict=False):
        axis.plot(value[i], y[i], "o", ms=7, color=color, zorder=5)
        axis.axvline(value[i], color=color, lw=0.8, ls=":")
    axis.set_yticks(y, [a.name for a in ablations], fontsize=8)
    axis.invert_yaxis()
    axis.set(title=label, xlim=(0.0, None))
    axis.title.set_fontsize(10)
    open_frame(axis)


TITLES = {
    "cutting": "ten pellets pushed 5 mm into the heart, forbidden from there on",
    "dissection": "ten pellets removed through a fulcrum, with guidance to their height",
    "tracking": "manual tracking of the beating surface over 30 cycles",
    "lesion": "a lesion along a beating line, the oesophagus behind it forbidden",
}
PANELS = {
    "cutting": (("depth_sd_mm", "SD of the depth, mm"), ("depth_rms_mm", "RMS about 5 mm, mm")),
    "dissection": (("time_s", "time, s"), ("errors", "touches of the organ")),
    "tracking": (("mean_mm", "mean distance to the surface, mm"), ("max_mm", "largest distance, mm")),
    "lesion": (
        ("line_mm", "mean distance to the line, mm"),
        ("tube_mm", "least distance to the oesophagus, mm"),
    ),
}
DEPTH_LIMITS_MM = {"cutting": (-10.0, 9.0), "dissection": (-6.0, 4.0)}
"""Tracking takes what its curves need."""
FORBIDDEN_MM = {"cutting": DEPTH_MM, "dissection": 0.0, "lesion": -MARGIN_MM}
ORDINATES = {
    "cutting": "depth below the true epicardium, mm",
    "dissection": "depth below the true organ, mm",
    "tracking": "along the inward normal, mm\n(thick: true surface)",
    "lesion": "towards the oesophagus (0: its surface), mm",
}
BELOW = (
    "Below each group: mean paired difference of the second condition to visual only, with its 95 % "
    "interval; "
    "thin lines join one operator's values, bars are means."
)
TRACKED_S = 3.6
"""So much of the tracking is drawn."""


def operators_shown(
    summary: OperatorsSummary, lines: Sequence[Line], notes: Sequence[str]
) -> OperatorsFigure:
    """Content of the figure; the curves are those of the first operator, computed again.

    Args:
        lines: trials, at least one that was not refused.
        notes: assumptions, printed below.
    """
    task, completed = summary.task, [line for line in lines if "refused" not in line]
    courses = _courses(task, int(completed[0]["seed"]))
    drawn = np.concatenate([curve.depth_mm for _, curves in courses for curve in curves])
    ablated = {row.condition: row.measures["depth_rms_mm"] for row in summary.ablations}
    return OperatorsFigure(
        title=f"{len(completed)} simulated operators: {TITLES[task]}",
        note=" ".join([*notes[:1], BELOW, *notes[-1:]]),
        courses=courses,
        ordinate=ORDINATES[task],
        depth_limits_mm=DEPTH_LIMITS_MM.get(task, (float(drawn.min()) - 0.3, float(drawn.max()) + 0.3)),
        forbidden_mm=FORBIDDEN_MM.get(task),
        kinds=tuple(c.name.split(", ", 1)[1] for c in next(iter(_groups(task).values()))),
        panels=[_panel(task, measure, label, completed) for measure, label in PANELS[task]],
        ablations=[
            Interval(_with_withheld(c.name, completed), *_triple(ablated[c.name]))
            for c in ABLATIONS
            if ablated
        ],
        ablation_label="beating heart, RMS about 5 mm, mm (95 % interval)",
    )


def _with_withheld(name: str, completed: Sequence[Line]) -> str:
    """The condition, and of how many operators the supervisor withheld the force."""
    count = sum(line["ablations"][name]["withheld_s"] > 0.0 for line in completed)
    return f"{name} (withheld: {count} of {len(completed)})" if count else name


def _triple(estimate: Estimate) -> tuple[float, float, float]:
    """Value and interval; without one, the value alone."""
    value = 0.0 if estimate.value is None else estimate.value
    low, high = estimate.low, estimate.high
    return value, value if low is None else low, value if high is None else high


def _signed(value: float | None) -> str:
    return "–" if value is None else f"{value:+.2f}".replace("-", "−")


def _groups(task: str) -> dict[str, list[Condition]]:
    """Conditions by what comes before their kind."""
    groups: dict[str, list[Condition]] = {}
    for condition in TASKS[task]:
        groups.setdefault(condition.name.split(", ")[0], []).append(condition)
    return groups


def _panel(task: str, measure: str, label: str, completed: Sequence[Line]) -> Panel:
    lines = [line["conditions"] for line in completed]
    compared = []
    for group, of in _groups(task).items():
        change = difference(measure, of[1].name, of[0].name, lines).mean
        said = f"{group}\n{_signed(change.value)}\n({_signed(change.low)} to {_signed(change.high)})"
        compared.append(Compared(said, np.array([[line[c.name][measure] for line in lines] for c in of])))
    return Panel(label, compared, _people(measure))


def _people(measure: str) -> tuple[tuple[float, str], ...]:
    """What people did in Ren 2008, and its name."""
    if measure == "mean_mm":
        return (paper.AUTOMATIC_MM, "Ren 2008, automatic"), (paper.MANUAL_MM, "Ren 2008, manual")
    arms = {
        "depth_sd_mm": paper.DEPTH_MM[:, :, 1].mean(axis=0),
        "depth_rms_mm": np.array(paper.depth_rms_mm()),
        "time_s": paper.DISSECTION_S.mean(axis=(0, 2)),
    }.get(measure, np.array([]))
    names = ("Ren 2008, with force", "Ren 2008, without")
    return tuple(zip(arms.tolist(), names, strict=False))


def _courses(task: str, seed: int) -> list[tuple[str, list[Curve]]]:
    """Without force and with it, by what these share."""
    draw = {"cutting": _cut, "dissection": _dissected, "tracking": _tracked, "lesion": _ablated}[task]
    return [(f"one operator, {group}", draw(of[:2], seed)) for group, of in _groups(task).items()]


def _cut(conditions: Sequence[Condition], seed: int) -> list[Curve]:
    traces = [cut(operating_heart(), condition, seed) for condition in conditions]
    return [Curve(k, trace.t_s, trace.depth_mm) for k, trace in enumerate(traces)]


def _dissected(conditions: Sequence[Condition], seed: int) -> list[Curve]:
    traces = [dissect(operating_heart(), condition, seed) for condition in conditions]
    return [Curve(k, trace.t_s, trace.depth_mm) for k, trace in enumerate(traces)]


def _ablated(conditions: Sequence[Condition], seed: int) -> list[Curve]:
    lesions = [ablate(operating_heart(), condition, seed) for condition in conditions]
    return [Curve(k, one.trace.t_s, -one.tube_mm) for k, one in enumerate(lesions)]


def _tracked(conditions: Sequence[Condition], seed: int) -> list[Curve]:
    """Motion of the surface, and of the tip."""
    heart = operating_heart()
    place = tracked_place(heart, surface_of(HEART_SEED), seed)
    point = moving_line(heart.truth, place, 0.0, 0.0)
    traces = [track(heart, place, condition, seed) for condition in conditions]
    t_s = traces[0].t_s[traces[0].t_s <= TRACKED_S]
    moved = [point.at(0.0, heart.phase(conditions[0], t)) - place.point_mm for t in t_s.tolist()]
    inward = -np.array(moved) @ place.normal
    tips = [Curve(k, t_s, inward + trace.depth_mm[: len(t_s)]) for k, trace in enumerate(traces)]
    return [Curve(None, t_s, inward), *tips]
