"""A rigid pose as six numbers of one size, and the bounded search over them.

ξ = (rotation vector · radius, translation), all in mm at the heart's radius: a left perturbation of the start
pose about the heart-box centre in the fixed frame.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from dvf_ig.core import FloatArray, Rigid

HEART_RADIUS_MM = 40.0
"""Turns rad into mm, so that rotation and translation steps move the heart equally."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseChart:
    """Six coordinates about a pose; see the module docstring."""

    base: Rigid
    center_mm: FloatArray

    def pose(self, xi_mm: FloatArray) -> Rigid:
        return self.base.perturbed_left(xi_mm[:3] / HEART_RADIUS_MM, xi_mm[3:], self.center_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """Where a search ended: coordinates, cost, evaluations, and whether its trust region closed."""

    xi_mm: FloatArray
    cost: float
    evaluations: int
    converged: bool


def search(
    cost: Callable[[FloatArray], float],
    start: FloatArray,
    *,
    first_step_mm: float,
    last_step_mm: float,
    bound_mm: float,
    max_evaluations: int,
) -> Search:
    """Minimise by COBYQA (Ragonneau and Zhang 2023): quadratic models in a trust region, no derivatives.

    Args:
        cost: of six coordinates in mm.
        first_step_mm, last_step_mm: initial and final trust-region radius.
        bound_mm: how far each coordinate may leave 0.
    """
    result = minimize(
        cost,
        start,
        method="COBYQA",
        bounds=[(-bound_mm, bound_mm)] * len(start),
        options={
            "initial_tr_radius": first_step_mm,
            "final_tr_radius": last_step_mm,
            "maxfev": max_evaluations,
        },
    )
    return Search(np.asarray(result.x), float(result.fun), int(result.nfev), bool(result.success))


def hessian(cost: Callable[[FloatArray], float], at: FloatArray, step_mm: float) -> FloatArray:
    """(6, 6) central-difference Hessian."""
    n = len(at)
    steps = np.eye(n) * step_mm
    middle = cost(at)
    plus = np.array([cost(at + s) for s in steps])
    minus = np.array([cost(at - s) for s in steps])
    out = np.diag((plus - 2 * middle + minus) / step_mm**2)
    for i in range(n):
        for j in range(i):
            both = cost(at + steps[i] + steps[j]) + cost(at - steps[i] - steps[j])
            mixed = both - plus[i] - minus[i] - plus[j] - minus[j] + 2 * middle
            out[i, j] = out[j, i] = mixed / (2 * step_mm**2)
    return out
