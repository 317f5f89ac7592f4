"""Banded matrices along one axis of an array: a tensor product, axis by axis.

A row of a banded matrix is the start of its window of `weights` and the weights themselves, so that

    (A v)[r] = Σ_j weights[r, j] · v[first[r] + j].

Arrays have three axes (before, along, after); `by_axis` in `preop.banded` gives them that shape. The
readable forms are NumPy products with the dense matrix, in the tests.
"""

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.kernels.compiled import kernel


@kernel
def multiply_axis(first: IntArray, weights: FloatArray, values: FloatArray, out: FloatArray) -> None:
    """Compute A v along the middle axis.

    Args:
        first: (s,) and weights: (s, k), the rows of A.
        values: (a, c, b); out: (a, s, b).
    """
    before, rows, after = out.shape
    window = weights.shape[1]
    for i in range(before):
        for r in range(rows):
            start = first[r]
            if after == 1:
                total = 0.0
                for j in range(window):
                    total += weights[r, j] * values[i, start + j, 0]
                out[i, r, 0] = total
                continue
            for k in range(after):
                out[i, r, k] = weights[r, 0] * values[i, start, k]
            for j in range(1, window):
                weight = weights[r, j]
                if weight != 0.0:
                    for k in range(after):
                        out[i, r, k] += weight * values[i, start + j, k]


@kernel
def multiply_axis_transposed(
    first: IntArray, weights: FloatArray, values: FloatArray, out: FloatArray
) -> None:
    """Compute Aᵀ v along the middle axis: (a, s, b) to (a, c, b), otherwise as `multiply_axis`."""
    before, rows, after = values.shape
    window = weights.shape[1]
    out[:] = 0.0
    for i in range(before):
        for r in range(rows):
            start = first[r]
            for j in range(window):
                weight = weights[r, j]
                if weight != 0.0:
                    for k in range(after):
                        out[i, start + j, k] += weight * values[i, r, k]


@kernel
def solve_axis(factor: FloatArray, values: FloatArray) -> None:
    """Compute (L Lᵀ)⁻¹ v along the middle axis, in place; fastest with a long last axis.

    Args:
        factor: (k, c) lower banded Cholesky factor, `factor[d, i]` = L[i + d, i], with the diagonal inverted.
        values: (a, c, b).
    """
    before, count, after = values.shape
    width = len(factor)
    for i in range(before):
        for r in range(count):
            for d in range(1, min(width, r + 1)):
                weight = factor[d, r - d]
                for k in range(after):
                    values[i, r, k] -= weight * values[i, r - d, k]
            for k in range(after):
                values[i, r, k] *= factor[0, r]
        for r in range(count - 1, -1, -1):
            for d in range(1, min(width, count - r)):
                weight = factor[d, r]
                for k in range(after):
                    values[i, r, k] -= weight * values[i, r + d, k]
            for k in range(after):
                values[i, r, k] *= factor[0, r]
