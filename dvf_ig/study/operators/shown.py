"""The figure of a task: one operator's traces, all operators' measures, the ablations of cutting."""

from collections.abc import Sequence

import numpy as np

from dvf_ig.report.study.operators import Compared, Curve, Interval, OperatorsFigure, Panel
from dvf_ig.study.hearts.summary import Estimate
from dvf_ig.study.trials import Line

from .conditions import ABLATIONS, HAPTICS, NO_HAPTICS, TASKS, UNATTENDED, Condition
from .cutting import CUT, DEPTH_MM, cut
from .dissection import dissect
from .heart import HEART_SEED, operating_heart, surface_of
from .moving_line import moving_line
from .summary import OperatorsSummary, difference
from .tracking import PAPER_AUTOMATIC_MM, PAPER_MANUAL_MM, track, tracked_place

KINDS = (NO_HAPTICS, HAPTICS, UNATTENDED)
TITLES = {
    "cutting": "depth-controlled cutting, forbidden surface 5 mm under the epicardium",
    "dissection": "dissection of ten pellets through a fulcrum",
    "tracking": "manual tracking of the beating surface over 30 cycles",
}
PANELS = {
    "cutting": (("depth_error_mm", "mean depth error, mm"), ("largest_excess_mm", "largest excess, mm")),
    "dissection": (("errors", "touches of the forbidden organ"), ("violation_mm", "deepest touch, mm")),
    "tracking": (("mean_mm", "mean distance to the surface, mm"), ("max_mm", "largest distance, mm")),
}
DEPTH_LIMITS_MM = {"cutting": (2.5, 8.0), "dissection": (-6.0, 4.0)}
"""Of tracking: what the curves need."""
FORBIDDEN_MM = {"cutting": DEPTH_MM, "dissection": 0.0}
ORDINATES = {
    "cutting": "depth below the true epicardium, mm",
    "dissection": "depth below the true organ, mm",
    "tracking": "along the inward normal, mm\n(thick: true surface)",
}
BELOW = (
    "Below each group: mean paired difference of visual + haptic to visual only, with its 95 % interval; "
    "thin lines join one operator's values, bars are means."
)
TRACKED_S = 3.6
"""So much of the tracking is drawn."""


def operators_shown(
    summary: OperatorsSummary, lines: Sequence[Line], notes: Sequence[str]
) -> OperatorsFigure:
    """What the figure shows; the curves are those of the first operator, worked out again.

    Args:
        lines: trials, at least one that was not refused.
        notes: assumptions, printed below.
    """
    task, done = summary.task, [line for line in lines if "refused" not in line]
    courses = _courses(task, int(done[0]["seed"]))
    drawn = np.concatenate([curve.depth_mm for _, curves in courses for curve in curves])
    ablated = {row.condition: row.measures["depth_error_mm"] for row in summary.ablations}
    return OperatorsFigure(
        title=f"{len(done)} simulated operators: {TITLES[task]}",
        note=" ".join([*notes[:1], BELOW, *notes[-1:]]),
        courses=courses,
        ordinate=ORDINATES[task],
        depth_limits_mm=DEPTH_LIMITS_MM.get(task, (float(drawn.min()) - 0.3, float(drawn.max()) + 0.3)),
        forbidden_mm=FORBIDDEN_MM.get(task),
        kinds=KINDS,
        panels=[_panel(task, measure, label, done) for measure, label in PANELS[task]],
        ablations=[
            Interval(_with_withheld(c.name, done), *_triple(ablated[c.name])) for c in ABLATIONS if ablated
        ],
        ablation_label="beating heart, mean depth error, mm (95 % interval)",
    )


def _with_withheld(name: str, done: Sequence[Line]) -> str:
    """The condition, and of how many operators the supervisor withheld the force."""
    count = sum(line["ablations"][name]["withheld_s"] > 0.0 for line in done)
    return f"{name} (withheld: {count} of {len(done)})" if count else name


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


def _panel(task: str, measure: str, label: str, done: Sequence[Line]) -> Panel:
    lines = [line["conditions"] for line in done]
    compared = []
    for group, of in _groups(task).items():
        change = difference(measure, of[1].name, of[0].name, lines).mean
        said = f"{group}\n{_signed(change.value)}\n({_signed(change.low)} to {_signed(change.high)})"
        compared.append(Compared(said, np.array([[line[c.name][measure] for line in lines] for c in of])))
    paper = (
        ((PAPER_AUTOMATIC_MM, "Ren 2008, automatic"), (PAPER_MANUAL_MM, "Ren 2008, manual"))
        if measure == "mean_mm"
        else ()
    )
    return Panel(label, compared, paper)


def _courses(task: str, seed: int) -> list[tuple[str, list[Curve]]]:
    """Without force and with it, by what these share."""
    draw = {"cutting": _cut, "dissection": _dissected, "tracking": _tracked}[task]
    return [(f"one operator, {group}", draw(of[:2], seed)) for group, of in _groups(task).items()]


def _cut(conditions: Sequence[Condition], seed: int) -> list[Curve]:
    """From the beginning of the cut on."""
    traces = [cut(operating_heart(), condition, seed) for condition in conditions]
    cutting = [trace.stage == CUT for trace in traces]
    return [
        Curve(k, trace.t_s[of] - trace.t_s[of][0], trace.depth_mm[of])
        for k, (trace, of) in enumerate(zip(traces, cutting, strict=True))
    ]


def _dissected(conditions: Sequence[Condition], seed: int) -> list[Curve]:
    traces = [dissect(operating_heart(), condition, seed).trace for condition in conditions]
    return [Curve(k, trace.t_s, trace.depth_mm) for k, trace in enumerate(traces)]


def _tracked(conditions: Sequence[Condition], seed: int) -> list[Curve]:
    """The surface, and the tip beside it."""
    heart = operating_heart()
    place = tracked_place(heart, surface_of(HEART_SEED), seed)
    point = moving_line(heart.truth, place, 0.0, 0.0)
    traces = [track(heart, place, condition, seed) for condition in conditions]
    t_s = traces[0].t_s[traces[0].t_s <= TRACKED_S]
    moved = [point.at(0.0, heart.phase(conditions[0], t)) - place.point_mm for t in t_s.tolist()]
    inward = -np.array(moved) @ place.normal
    tips = [Curve(k, t_s, inward + trace.depth_mm[: len(t_s)]) for k, trace in enumerate(traces)]
    return [Curve(None, t_s, inward), *tips]
