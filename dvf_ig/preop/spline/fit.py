"""Least squares for tensor-product cubic B-splines on a full grid (Ren 2008, eq. 2).

The paper trains by gradient descent (eq. 3) on the same quadratic. On a full grid its minimum separates by
axis (`fit_coefficients`): one banded Cholesky factor per axis, shared by all phases, gives it directly.
Weights that emphasise the surface do not separate; the separable solution is then the start and the
preconditioner of conjugate gradients (`fit_weighted`). The splines are uniform and cubic with one knot pitch,
as the kernels evaluate them. Other degrees and pitches (eq. 1) and the paper's gradient descent (eq. 3) are
in `dvf_ig.study.training`, which compares the three ways to the minimum.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.preop.conjugate_gradients import conjugate_gradients

SAMPLES_PER_KNOT = 2

SIGMA_KNOTS = 0.3
"""Width of the band that `surface_weights` emphasises, in knots; tuned on two phases of phantom 101."""

FAR_WEIGHT = 0.01
"""Weight far from the surface: it keeps the field defined there and bounds the number of iterations."""

TOLERANCE = 0.05
MAX_ITERATIONS = 40


def cubic_basis(cells: int, samples_per_knot: int = SAMPLES_PER_KNOT) -> csr_array:
    """(cells·s + 1, cells + 3) values of the cubic B-splines at u = 0, 1/s, …, cells."""
    u = np.arange(cells * samples_per_knot + 1) / samples_per_knot
    cell = np.minimum(u.astype(np.int64), cells - 1)
    t = u - cell
    values = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1)
    rows = np.repeat(np.arange(len(u)), 4)
    columns = (cell[:, None] + np.arange(4)).ravel()
    return csr_array((values.ravel() / 6.0, (rows, columns)), shape=(len(u), cells + 3))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AxisSolver:
    """Least squares along one axis: coefficients = (AᵀA)⁻¹ Aᵀ samples."""

    basis: csr_array
    transposed: csr_array
    factor: FloatArray

    @classmethod
    def of(cls, cells: int) -> "AxisSolver":
        basis = cubic_basis(cells)
        normal = (basis.T @ basis).toarray()
        banded = np.zeros((4, len(normal)))
        for below in range(4):
            banded[below, : len(normal) - below] = np.diagonal(normal, -below)
        return cls(basis, basis.T.tocsr(), cholesky_banded(banded, lower=True))

    def solve(self, samples: FloatArray) -> FloatArray:
        """(s, k) samples to (c, k) coefficients."""
        return self.solve_normal(self.transposed @ samples)

    def solve_normal(self, right: FloatArray) -> FloatArray:
        """(AᵀA)⁻¹ of (c, k)."""
        return np.asarray(cho_solve_banded((self.factor, True), right, check_finite=False))


AxisSolvers = tuple[AxisSolver, AxisSolver, AxisSolver]


def fit_coefficients(samples: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """(sx, sy, sz) samples to (cx, cy, cz) coefficients that minimise the sum of squared residuals."""
    for solver in solvers:
        samples = _next_axis(solver.solve(_flat(samples)), samples)
    return samples


def surface_weights(distance_mm: FloatArray, knot_spacing_mm: float) -> FloatArray:
    """max(exp(−d²/2σ²), 0.01), σ = 0.3 knots: what cannot be fitted everywhere is fitted here.

    What pulls an unweighted fit off the surface are the creases of the distance map: its medial axis, and the
    grooves of the surface, where that axis touches it.
    """
    return np.maximum(np.exp(-0.5 * (distance_mm / (SIGMA_KNOTS * knot_spacing_mm)) ** 2), FAR_WEIGHT)


def fit_weighted(samples: FloatArray, weights: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """(cx, cy, cz) coefficients c that minimise Σ w (d − A c)², from samples d (sx, sy, sz) on a full grid.

    Conjugate gradients on AᵀWA c = AᵀW d, preconditioned with (AᵀA)⁻¹ and started from the unweighted fit;
    the eigenvalues lie between the smallest and the largest weight. Ends when the preconditioned residual has
    fallen to 5 % of what the unweighted fit leaves, or after 40 steps.

    Args:
        weights: (sx, sy, sz) positive.
    Raises:
        InvalidInputError: a weight that is not positive and finite, or another shape.
    """
    if weights.shape != samples.shape or not (np.isfinite(weights).all() and (weights > 0.0).all()):
        raise InvalidInputError(
            f"weights of shape {weights.shape} for samples of shape {samples.shape}; needed the same shape, "
            "every weight positive and finite"
        )
    unweighted = fit_coefficients(samples, solvers)
    change = conjugate_gradients(
        lambda c: _adjoint(weights * grid_values(c, solvers), solvers),
        _adjoint(weights * (samples - grid_values(unweighted, solvers)), solvers),
        lambda r: _preconditioned(r, solvers),
        tolerance=TOLERANCE,
        max_iterations=MAX_ITERATIONS,
    )
    return np.asarray(unweighted + change.x)


def grid_values(coefficients: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """A c: (cx, cy, cz) coefficients to the (sx, sy, sz) values at the samples."""
    for solver in solvers:
        coefficients = _next_axis(solver.basis @ _flat(coefficients), coefficients)
    return coefficients


def _adjoint(samples: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """Aᵀ r."""
    for solver in solvers:
        samples = _next_axis(solver.transposed @ _flat(samples), samples)
    return samples


def _preconditioned(residual: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """(AᵀA)⁻¹ r."""
    for solver in solvers:
        residual = _next_axis(solver.solve_normal(_flat(residual)), residual)
    return residual


def _flat(array: FloatArray) -> FloatArray:
    """(n, …) as (n, k)."""
    return array.reshape(len(array), -1)


def _next_axis(flat: FloatArray, before: FloatArray) -> FloatArray:
    """The first axis, just processed, moved to the end: three such steps restore the order."""
    return np.ascontiguousarray(np.moveaxis(flat.reshape(-1, *before.shape[1:]), 0, -1))
