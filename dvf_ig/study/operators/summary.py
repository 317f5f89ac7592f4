"""Summary of the operators' trials: each condition, and paired differences to the one without force.

The unit is the simulated operator. Means have bootstrap intervals over operators (95 %); a difference is
that of the same operator under two conditions, with its effect size d_z, the mean difference over the
standard deviation of the differences (Cohen 1988), whose interval is the large-sample one (Hedges and Olkin
1985).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.study.driver import Line
from dvf_ig.study.operators.closed_loop import HAPTICS, NO_HAPTICS, TASKS, UNATTENDED
from dvf_ig.study.statistics import Estimate, bootstrap

MEASURES = {
    "cutting": ("depth_mean_mm", "depth_sd_mm", "depth_rms_mm", "perforations"),
    "dissection": ("time_s", "errors", "violation_mm", "pellets"),
    "tracking": ("mean_mm", "p95_mm", "max_mm"),
    "lesion": ("line_mm", "within_share", "tube_mm", "within_margin_s", "time_s"),
}
"""Measures of each task that tables show."""
MORE_IS_BETTER = ("pellets", "within_share", "tube_mm")
LEAST = 3
"""Fewer operators have no effect size."""
NORMAL_975 = 1.959964
SAME = 1e-9
"""Differences that vary by less have no effect size."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One measure of the same operators under two conditions.

    Attributes:
        measure: its name.
        condition, reference: of both.
        mean: mean of condition − reference, with its 95 % interval.
        relative: mean difference over the reference's mean; None if that is 0.
        effect_size: d_z, with its 95 % interval; None if the differences do not vary.
        better: operators with less under the condition, or more of what is MORE_IS_BETTER; of: all.
    """

    measure: str
    condition: str
    reference: str
    mean: Estimate
    relative: float | None
    effect_size: Estimate
    better: int
    of: int


@dataclass(frozen=True, slots=True)
class Row:
    """All measures of one condition: mean over operators with its 95 % interval."""

    condition: str
    measures: dict[str, Estimate]


@dataclass(frozen=True, slots=True)
class OperatorsSummary:
    """A task.

    Attributes:
        operators: done; failed: ended in an error.
        rows: of its conditions; ablations: of those, if any.
        differences: of each condition with force to the one without on the same heart and sight.
    """

    task: str
    operators: int
    failed: int
    rows: tuple[Row, ...]
    ablations: tuple[Row, ...]
    differences: tuple[Difference, ...]


def summarise_operators(task: str, lines: Sequence[Line]) -> OperatorsSummary:
    """Rows and differences of a task's trials."""
    completed = [line for line in lines if "refused" not in line]
    conditions = [line["conditions"] for line in completed]
    names = [c.name for c in TASKS[task]] if completed else []
    pairs = [
        (name, name.replace(felt, NO_HAPTICS))
        for name in names
        for felt in (HAPTICS, UNATTENDED)
        if name.endswith(felt)
    ]
    return OperatorsSummary(
        task,
        len(completed),
        len(lines) - len(completed),
        _rows(conditions),
        _rows([line["ablations"] for line in completed if "ablations" in line]),
        tuple(
            difference(measure, name, reference, conditions)
            for name, reference in pairs
            for measure in MEASURES[task]
        ),
    )


def difference(
    measure: str, condition: str, reference: str, lines: Sequence[dict[str, dict[str, float]]]
) -> Difference:
    """A paired difference over operators, one of `lines` each: measures by condition."""
    with_it, without = (np.array([line[name][measure] for line in lines]) for name in (condition, reference))
    change = with_it - without
    improvement = change if measure in MORE_IS_BETTER else -change
    mean = float(without.mean())
    return Difference(
        measure,
        condition,
        reference,
        bootstrap(change.tolist(), np.mean),
        float(change.mean()) / mean if mean != 0.0 else None,
        _effect_size(change),
        int((improvement > 0.0).sum()),
        len(change),
    )


def _effect_size(change: FloatArray) -> Estimate:
    if len(change) < LEAST or float(change.std()) < SAME:
        return Estimate(None, None, None)
    n = len(change)
    value = float(change.mean() / change.std(ddof=1))
    half = NORMAL_975 * math.sqrt(1.0 / n + value**2 / (2.0 * n))
    return Estimate(value, value - half, value + half)


def _rows(lines: Sequence[dict[str, dict[str, float]]]) -> tuple[Row, ...]:
    if not lines:
        return ()
    return tuple(
        Row(name, {m: bootstrap([line[name][m] for line in lines], np.mean) for m in measures})
        for name, measures in lines[0].items()
    )
