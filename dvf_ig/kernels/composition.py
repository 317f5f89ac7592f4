"""Composition of several fixtures' forces: forbidden regions before guidance, within one cap.

`dvf_ig.guidance.composition` explains the rule and calls this kernel; so does the servo loop. The only
iteration is an active-set solution of a non-negative least-squares problem with one unknown a region.
"""

import math
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray

from .compiled import inlined, kernel

COMPOSED = np.dtype(
    [
        ("forbidden_n", np.float64, (3,)),
        ("guidance_n", np.float64, (3,)),
        ("rejected_n", np.float64, (3,)),
        ("saturated", np.int64),
        ("conflict", np.int64),
    ]
)
"""The parts of a composition, and whether the cap shortened it or fixtures oppose each other."""

CONFLICT_SHARE = 0.25
"""Rejected guidance, as a share of the cap, above which it conflicts with forbidden regions."""
OPPOSED_SHARE = 0.5
"""Share of the forbidden regions' forces that cancels from which these conflict."""
NEGLIGIBLE_SHARE = 0.1
"""Cancelled force, as a share of the cap, below which there is no conflict."""
DEPENDENT = 1e-12
"""Share of its squared length that a region's column must keep to add anything to those before it."""
NORMAL = 0
ACTIVATION = 3
LAMBDA = 4
TARGET = 5
CLASS = 6
COLUMNS = 7
"""Columns of the work space: unit vector into the region, activation, λ, bᵢ, whether λ may be positive; then
the regions' normal equations and their factor."""


def work_size(fixtures: int) -> tuple[int, int]:
    """Return the shape of the work space for `fixtures` fixtures."""
    return fixtures, COLUMNS + 2 * fixtures + 1


@inlined
def ordered(forces_n: FloatArray, caps_n: FloatArray, order: FloatArray) -> None:
    """Sort indices by value into `order`, so that not even rounding depends on the caller's order."""
    for i in range(len(forces_n)):
        at = i
        while at > 0:
            j = int(order[at - 1])
            before = caps_n[i] < caps_n[j]
            for k in range(2, -1, -1):
                if forces_n[i, k] != forces_n[j, k]:
                    before = forces_n[i, k] < forces_n[j, k]
            if not before:
                break
            order[at] = order[at - 1]
            at -= 1
        order[at] = float(i)


@kernel
def _factor_solve(work: FloatArray, count: int, out: int) -> None:
    """Solve by Cholesky over the regions in the class; 0 for the others and for dependent columns."""
    low = COLUMNS + count
    for i in range(count):
        work[i, out] = 0.0
        if work[i, CLASS] == 0.0:
            continue
        right = work[i, TARGET]
        for j in range(i):
            if work[j, CLASS] == 0.0:
                continue
            total = work[i, COLUMNS + j]
            for k in range(j):
                if work[k, CLASS] != 0.0:
                    total -= work[i, low + k] * work[j, low + k]
            work[i, low + j] = total / work[j, low + j] if work[j, low + j] > 0.0 else 0.0
            right -= work[i, low + j] * work[j, out]
        pivot = work[i, COLUMNS + i]
        for k in range(i):
            if work[k, CLASS] != 0.0:
                pivot -= work[i, low + k] * work[i, low + k]
        work[i, low + i] = math.sqrt(pivot) if pivot > DEPENDENT else 0.0
        work[i, out] = right / work[i, low + i] if work[i, low + i] > 0.0 else 0.0
    for i in range(count - 1, -1, -1):
        if work[i, CLASS] == 0.0 or work[i, low + i] == 0.0:
            continue
        total = work[i, out]
        for j in range(i + 1, count):
            if work[j, CLASS] != 0.0:
                total -= work[j, low + i] * work[j, out]
        work[i, out] = total / work[i, low + i]


@kernel
def _solve_multipliers(work: FloatArray, count: int) -> None:
    """Find λ >= 0 of least ½λᵀGλ − bᵀλ by Lawson and Hanson's active set on the normal equations."""
    trial = COLUMNS + 2 * count
    for i in range(count):
        work[i, LAMBDA] = work[i, CLASS] = 0.0
    for _ in range(3 * count + 1):
        best, steepest = -1, 1e-14
        for i in range(count):
            if work[i, CLASS] == 0.0:
                slope = work[i, TARGET]
                for j in range(count):
                    slope -= work[i, COLUMNS + j] * work[j, LAMBDA]
                if slope > steepest:
                    best, steepest = i, slope
        if best < 0:
            return
        work[best, CLASS] = 1.0
        for _ in range(count + 1):
            _factor_solve(work, count, trial)
            share, leaving = 1.0, -1
            for i in range(count):
                if work[i, CLASS] != 0.0 and work[i, trial] <= 0.0:
                    gap = work[i, LAMBDA] - work[i, trial]
                    step = work[i, LAMBDA] / gap if gap > 0.0 else 0.0
                    if step < share:
                        share, leaving = step, i
            for i in range(count):
                if work[i, CLASS] != 0.0:
                    moved = work[i, LAMBDA] + share * (work[i, trial] - work[i, LAMBDA])
                    work[i, LAMBDA] = max(moved, 0.0)
            if leaving < 0:
                break
            work[leaving, CLASS] = work[leaving, LAMBDA] = 0.0


@inlined
def _regions(
    forces_n: FloatArray, caps_n: FloatArray, forbidden: FloatArray, order: FloatArray, work: FloatArray
) -> int:
    """Write unit vectors into the pushing regions and their activations to the work space; count them."""
    count = 0
    for at in range(len(order)):
        i = int(order[at])
        x, y, z = forces_n[i, 0], forces_n[i, 1], forces_n[i, 2]
        size = math.sqrt(x * x + y * y + z * z)
        if forbidden[i] == 0.0 or size == 0.0:
            continue
        f = min(1.0, size / caps_n[i])
        work[count, NORMAL], work[count, NORMAL + 1], work[count, NORMAL + 2] = (
            -x / size,
            -y / size,
            -z / size,
        )
        work[count, ACTIVATION] = f
        count += 1
    return count


@kernel
def without_inward_part(
    forces_n: FloatArray,
    caps_n: FloatArray,
    forbidden: FloatArray,
    order: FloatArray,
    guidance_n: FloatArray,
    work: FloatArray,
) -> None:
    """Remove from `guidance_n` (3,), in place, the part that leads into the forbidden regions.

    The minimiser of ½|x − F|² + ½ Σ f/(1−f) max(0, x·n)² is x = F − Nλ, λ >= 0 of least |F − Nλ|² +
    Σ λᵢ²(1−fᵢ)/fᵢ; solved for λᵢ/√fᵢ, whose columns √fᵢnᵢ, √(1−fᵢ)eᵢ have unit length.
    """
    count = _regions(forces_n, caps_n, forbidden, order, work)
    for i in range(count):
        along = 0.0
        for k in range(3):
            along += work[i, k] * guidance_n[k]
        work[i, TARGET] = math.sqrt(work[i, ACTIVATION]) * along
        for j in range(i):
            cosine = work[i, 0] * work[j, 0] + work[i, 1] * work[j, 1] + work[i, 2] * work[j, 2]
            product = math.sqrt(work[i, ACTIVATION] * work[j, ACTIVATION]) * cosine
            work[i, COLUMNS + j] = work[j, COLUMNS + i] = product
        work[i, COLUMNS + i] = 1.0
    if count == 0:
        return
    _solve_multipliers(work, count)
    for i in range(count):
        push = math.sqrt(work[i, ACTIVATION]) * work[i, LAMBDA]
        for k in range(3):
            guidance_n[k] -= push * work[i, k]


@inlined
def compose_forces(
    forces_n: FloatArray,
    caps_n: FloatArray,
    forbidden: FloatArray,
    cap_n: float,
    work: FloatArray,
    order: FloatArray,
    out: Any,
) -> None:
    """Compose the forces of all fixtures.

    Args:
        forces_n: (k, 3) N of the fixtures; caps_n: (k,) of their laws; forbidden: (k,) 1, or 0 for guidance.
        cap_n: largest total force.
        work: `work_size(k)`; order: (k,).
        out: COMPOSED.
    """
    ordered(forces_n, caps_n, order)
    pushed, guidance, rejected = out.forbidden_n, out.guidance_n, out.rejected_n
    out.saturated = 0
    for k in range(3):
        pushed[k] = guidance[k] = 0.0
    sizes = 0.0
    for at in range(len(order)):
        i = int(order[at])
        part = pushed if forbidden[i] != 0.0 else guidance
        for k in range(3):
            part[k] += forces_n[i, k]
        if forbidden[i] != 0.0:
            sizes += math.sqrt(forces_n[i, 0] ** 2 + forces_n[i, 1] ** 2 + forces_n[i, 2] ** 2)
    before = (guidance[0], guidance[1], guidance[2])
    if sizes > 0.0 and (before[0] != 0.0 or before[1] != 0.0 or before[2] != 0.0):
        without_inward_part(forces_n, caps_n, forbidden, order, guidance, work)
    for k in range(3):
        rejected[k] = before[k] - guidance[k]
    total = math.sqrt(pushed[0] ** 2 + pushed[1] ** 2 + pushed[2] ** 2)
    cancelled = sizes - total
    if total > cap_n:
        out.saturated = 1
        for k in range(3):
            pushed[k] *= cap_n / total
    rest = max(0.0, cap_n - total)
    length = math.sqrt(guidance[0] ** 2 + guidance[1] ** 2 + guidance[2] ** 2)
    if length > rest:
        out.saturated = 1
        for k in range(3):
            guidance[k] *= rest / length
    lost = math.sqrt(rejected[0] ** 2 + rejected[1] ** 2 + rejected[2] ** 2)
    opposed = cancelled > max(OPPOSED_SHARE * sizes, NEGLIGIBLE_SHARE * cap_n)
    out.conflict = 1 if lost > CONFLICT_SHARE * cap_n or opposed else 0
