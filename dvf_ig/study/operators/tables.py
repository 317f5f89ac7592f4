"""Tables I, III and IV of Ren 2008, its rows next to those of simulated operators or of who trained here.

Both sides have the same statistics, by subject: means over subjects, and the p of a paired t test.
"""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from scipy.stats import ttest_rel

from dvf_ig.core import FloatArray
from dvf_ig.study.driver import Line, Rows
from dvf_ig.study.operators import paper
from dvf_ig.study.operators.closed_loop import HAPTICS, MONO, NO_HAPTICS, STEREO

Subjects = Mapping[str, FloatArray]
"""Figures of each subject by name; the arm is the first axis, with force before without."""
ARMS = ("with force", "without")
LEAST = 3
"""Fewer subjects have no p."""
HEADS = {
    "I": ("depth of pellets pushed to 5 mm, mm", *ARMS),
    "III": ("time to remove ten pellets, s", *ARMS),
    "IV": ("time, s", *(f"{sight} {arm}" for sight in (MONO, STEREO) for arm in ARMS)),
}


def depth_rows(subjects: Subjects, shown: int | None = None) -> Rows:
    """Rows of Table I: mean ± SD of a subject's pellets, (arms, 2) each.

    Args:
        shown: number of subjects with a row of their own; None: all.
    """
    rows: Rows = [(name, *(f"{m:.2f} ± {s:.2f}" for m, s in arms)) for name, arms in subjects.items()]
    every = np.array(list(subjects.values()))
    rms = np.sqrt((every[:, :, 0] - paper.WANTED_MM) ** 2 + every[:, :, 1] ** 2).mean(axis=0)
    means = every.mean(axis=0)
    return [
        *rows[:shown],
        (_all_of(every), *(f"{m:.2f} ± {s:.2f}" for m, s in means)),
        ("RMS about 5 mm", *(f"{v:.2f}" for v in rms)),
        ("p: same mean, same variation", *(_p(every[:, 0, k], every[:, 1, k]) for k in (0, 1))),
    ]


def time_rows(subjects: Subjects, shown: int | None = None) -> Rows:
    """Rows of Tables III and IV: seconds; of several trials, all of them.

    Args:
        subjects: (arms,) each, or (arms, trials); arms in pairs with and without force.
        shown: as of `depth_rows`.
    """
    rows: Rows = [(name, *map(_seconds, arms)) for name, arms in subjects.items()]
    every = np.array([[np.mean(arm) for arm in arms] for arms in subjects.values()])
    means, pairs = every.mean(axis=0), every.shape[1] // 2
    less = [100.0 * (1.0 - means[2 * k] / means[2 * k + 1]) for k in range(pairs)]
    p = [_p(every[:, 2 * k], every[:, 2 * k + 1]) for k in range(pairs)]
    both = _p(every[:, ::2].mean(axis=1), every[:, 1::2].mean(axis=1))
    out: Rows = [
        *rows[:shown],
        (_all_of(every), *(f"{m:.1f}" for m in means)),
        ("less with force", *(cell for share in less for cell in (f"{share:.0f} %", ""))),
        ("p of the force", *(cell for one in p for cell in (one, ""))),
    ]
    if pairs == 1:
        return out
    sight = _p(every[:, :2].mean(axis=1), every[:, 2:].mean(axis=1))
    return [*out, ("p: force over both, sight", both, "", sight, "")]


def operators_subjects(task: str, lines: Sequence[Line], heart: str = "") -> dict[str, Subjects]:
    """Simulated operators of `study operators` as subjects of the tables of a task.

    Args:
        heart: of cutting: the condition's heart.
    """
    lines = [line for line in lines if "refused" not in line]
    names = [f"operator {k + 1}" for k in range(len(lines))]

    def figures(line: Line, group: str, *measures: str) -> list[Any]:
        by = line["conditions"]
        cells = [[by[f"{group}, {arm}"][m] for m in measures] for arm in (HAPTICS, NO_HAPTICS)]
        return cells if len(measures) > 1 else [cell[0] for cell in cells]

    if task == "cutting":
        depth = [np.array(figures(line, heart, "depth_mean_mm", "depth_sd_mm")) for line in lines]
        return {"I": dict(zip(names, depth, strict=True))}
    mono, stereo = ([figures(line, sight, "time_s") for line in lines] for sight in (MONO, STEREO))
    both = [np.array([*a, *b]) for a, b in zip(mono, stereo, strict=True)]
    return {
        "III": dict(zip(names, map(np.array, mono), strict=True)),
        "IV": dict(zip(names, both, strict=True)),
    }


def training_tables(task: str, lines: Sequence[Mapping[str, Any]]) -> Rows:
    """Tables of a task with those who trained, next to the paper's people; lines of a training log.

    A subject without both arms, or of Table IV without both sights, is in no row; a trial that ended early
    does not count.
    """
    arms: dict[tuple[str, str], FloatArray] = {}
    played = [line for line in lines if line["task"] == task and line["complete"]]
    for person, sight in dict.fromkeys((line["person"], line["condition"].split(", ")[0]) for line in played):
        own = [
            [line for line in played if line["person"] == person and line["condition"] == f"{sight}, {arm}"]
            for arm in (HAPTICS, NO_HAPTICS)
        ]
        if all(own):
            arms[person, sight] = np.array([_figures(task, arm) for arm in own])
    if task == "cutting":
        kinds = {"I": {f"{person}, {sight}": figures for (person, sight), figures in arms.items()}}
    else:
        mono, stereo = ({who: v for (who, of), v in arms.items() if of == sight} for sight in (MONO, STEREO))
        both = {who: np.concatenate([mono[who], stereo[who]]) for who in mono if who in stereo}
        kinds = {"III": mono, "IV": both}
    return [row for kind, subjects in kinds.items() for row in (*paper_table(kind, subjects, "here"), ("",))]


def _figures(task: str, trials: Sequence[Mapping[str, Any]]) -> list[float]:
    """Mean and SD of all pellets, or the mean time."""
    if task == "dissection":
        return [float(np.mean([trial["measures"]["time_s"] for trial in trials]))]
    depths = np.concatenate([trial["pellet_depths_mm"] for trial in trials])
    return [float(depths.mean()), float(depths.std(ddof=1)) if len(depths) > 1 else 0.0]


def paper_table(kind: str, subjects: Subjects, label: str, shown: int | None = None) -> Rows:
    """One table, I, III or IV: the paper's people, and next to them other subjects, if there are any."""
    make = depth_rows if kind == "I" else time_rows
    people = {"I": paper.DEPTH_MM, "III": paper.DISSECTION_S, "IV": paper.SIGHT_S}[kind]
    left = make({f"person {k + 1}": arms for k, arms in enumerate(people)})
    right = make(subjects, shown) if subjects else []
    head, statistics = HEADS[kind], len(left) - len(people)
    blank = ("",) * len(head)
    rows = [
        *zip_longest(left[:-statistics], right[:-statistics], fillvalue=blank),
        *zip_longest(left[-statistics:], right[-statistics:], fillvalue=blank),
    ]
    titles = (f"Table {kind}, {head[0]}", *head[1:])
    return [(*titles, label, *head[1:]), *((*a, *b) for a, b in rows)]


def _all_of(every: FloatArray) -> str:
    return f"all {len(every)}"


def _seconds(arm: FloatArray) -> str:
    return " ".join(f"{v:.0f}" for v in arm) if np.ndim(arm) else f"{arm:.1f}"


def _p(one: FloatArray, other: FloatArray) -> str:
    if len(one) < LEAST or np.array_equal(one, other):
        return "–"
    p = float(ttest_rel(one, other).pvalue)
    return "< .001" if p < 0.001 else f"{p:.3f}".removeprefix("0")
