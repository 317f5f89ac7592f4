"""Preconditioned conjugate gradients: the solver of large symmetric systems in the pre-operative part.

Motion from images, the random walker of the segmentation, the weighted spline fit and the training of
scattered samples all end in A x = b with A symmetric, positive definite and known only as an operator.

`scipy.sparse.linalg.cg` is the same recurrence, with which a test compares this one. It is not used, because
its inner products are those of BLAS, which adds in an order that changes with the number of threads from
about ten thousand unknowns on: results would no longer be bit-identical at any thread count. NumPy's own sum
has one order.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Stop, read_only_arrays

Operator = Callable[[FloatArray], FloatArray]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """An approximate solution.

    Attributes:
        x: of the shape of the right-hand side.
        stop: CONVERGED, or MAX_ITERATIONS.
        iterations: steps taken.
    """

    x: FloatArray
    stop: Stop
    iterations: int


def conjugate_gradients(
    operator: Operator,
    right: FloatArray,
    preconditioner: Operator,
    *,
    tolerance: float,
    max_iterations: int,
    on_iteration: Callable[[FloatArray], None] | None = None,
) -> Solution:
    """Solve A x = b from x = 0.

    Args:
        operator: x ↦ A x, symmetric and positive definite, for arrays of the shape of `right`.
        right: b, of any shape.
        preconditioner: r ↦ M⁻¹ r, symmetric and positive definite.
        tolerance: stop when the residual's norm √(rᵀM⁻¹r) has fallen to this share of the first one.
        max_iterations: most steps.
        on_iteration: called with x after every step.
    Source: Hestenes and Stiefel 1952; Saad, Iterative Methods for Sparse Linear Systems, algorithm 9.1.
    """
    x, residual = np.zeros_like(right), right
    conditioned = preconditioner(residual)
    direction, power = conditioned.copy(), _inner(residual, conditioned)
    enough = tolerance**2 * power
    count = 0
    while count < max_iterations and not power <= enough:
        image = operator(direction)
        step = power / _inner(direction, image)
        x += step * direction
        residual = residual - step * image
        conditioned = preconditioner(residual)
        previous, power = power, _inner(residual, conditioned)
        direction *= power / previous
        direction += conditioned
        count += 1
        if on_iteration is not None:
            on_iteration(x.copy())
    return Solution(x, Stop.CONVERGED if power <= enough else Stop.MAX_ITERATIONS, count)


def _inner(a: FloatArray, b: FloatArray) -> float:
    """Compute aᵀb, added in NumPy's order."""
    return float((a * b).sum())
