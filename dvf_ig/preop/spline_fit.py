"""Exact least squares for tensor-product cubic B-splines on a full grid: three 1-D solves (Ren 2008, eq. 2).

The paper trains by gradient descent (eq. 3) on the same quadratic; on a full grid its minimum separates by
axis, so one banded Cholesky factor per axis, shared by all phases, gives it directly.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array

from dvf_ig.core import FloatArray

SAMPLES_PER_KNOT = 2


def cubic_basis(cells: int, samples_per_knot: int = SAMPLES_PER_KNOT) -> csr_array:
    """(cells·s + 1, cells + 3) values of the cubic B-splines at u = 0, 1/s, …, cells."""
    u = np.arange(cells * samples_per_knot + 1) / samples_per_knot
    cell = np.minimum(u.astype(np.int64), cells - 1)
    t = u - cell
    values = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1)
    rows = np.repeat(np.arange(len(u)), 4)
    columns = (cell[:, None] + np.arange(4)).ravel()
    return csr_array((values.ravel() / 6.0, (rows, columns)), shape=(len(u), cells + 3))


@dataclass(frozen=True, slots=True, eq=False)
class AxisSolver:
    """Least squares along one axis: coefficients = (AᵀA)⁻¹ Aᵀ samples."""

    basis: csr_array
    factor: FloatArray

    @classmethod
    def of(cls, cells: int) -> "AxisSolver":
        basis = cubic_basis(cells)
        normal = (basis.T @ basis).toarray()
        banded = np.zeros((4, len(normal)))
        for below in range(4):
            banded[below, : len(normal) - below] = np.diagonal(normal, -below)
        return cls(basis, cholesky_banded(banded, lower=True))

    def solve(self, samples: FloatArray) -> FloatArray:
        """(s, …) samples to (c, …) coefficients along the first axis."""
        flat = samples.reshape(len(samples), -1)
        solved = cho_solve_banded((self.factor, True), self.basis.T @ flat, check_finite=False)
        return np.asarray(solved).reshape(-1, *samples.shape[1:])


def fit_coefficients(samples: FloatArray, solvers: tuple[AxisSolver, AxisSolver, AxisSolver]) -> FloatArray:
    """(sx, sy, sz) samples to (cx, cy, cz) coefficients that minimise the sum of squared residuals."""
    for axis, solver in enumerate(solvers):
        samples = np.moveaxis(solver.solve(np.ascontiguousarray(np.moveaxis(samples, axis, 0))), 0, axis)
    return np.ascontiguousarray(samples)
