"""Least squares for tensor-product cubic B-splines on a full grid (Ren 2008, eq. 2).

The paper trains by gradient descent (eq. 3) on the same quadratic. On a full grid its minimum separates by
axis (`fit_coefficients`): one banded Cholesky factor per axis, shared by all phases, gives it directly.
Weights that emphasise the surface do not separate; the separable solution is then the start and the
preconditioner of conjugate gradients (`fit_weighted`). The splines are uniform and cubic with one knot pitch,
as the kernels evaluate them. Other degrees and pitches (eq. 1) and the paper's gradient descent (eq. 3) are
in `dvf_ig.study.training`, which compares the three ways to the minimum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky_banded

from dvf_ig.core import FloatArray, Grid, IntArray, InvalidInputError, Mesh, read_only_arrays
from dvf_ig.kernels.grid.scattered import AxisRows, add_from_nodes, values_at_nodes
from dvf_ig.kernels.grid.separable import solve_axis
from dvf_ig.preop.banded import BandedRows, by_axis
from dvf_ig.preop.conjugate_gradients import conjugate_gradients
from dvf_ig.preop.distance.signed import signed_distance_mm

SAMPLES_PER_KNOT = 2

SIGMA_KNOTS = 0.3
"""Width of the band that `surface_weights` emphasises, in knots."""

FAR_WEIGHT = 0.01
"""Weight far from the surface, which keeps the field defined there and bounds the number of iterations."""

WEIGHTED_KNOTS = SIGMA_KNOTS * float(np.sqrt(-2.0 * np.log(FAR_WEIGHT)))
"""Distance from the surface in knots (0.91) beyond which all samples have FAR_WEIGHT."""

TOLERANCE = 0.05
MAX_ITERATIONS = 40


def cubic_basis(cells: int) -> BandedRows:
    """Build the (cells·s + 1, cells + 3) values of the cubic B-splines at u = 0, 1/s, …, cells."""
    u = np.arange(cells * SAMPLES_PER_KNOT + 1) / SAMPLES_PER_KNOT
    cell = np.minimum(u.astype(np.int64), cells - 1)
    t = u - cell
    values = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1)
    return BandedRows(cell, values / 6.0, cells + 3)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AxisSolver:
    """Least squares along one axis: coefficients = (AᵀA)⁻¹ Aᵀ samples.

    Attributes:
        basis: A; normal: AᵀA.
        factor: (4, c) banded Cholesky factor of AᵀA, its diagonal inverted.
    """

    basis: BandedRows
    normal: BandedRows
    factor: FloatArray

    @classmethod
    def of(cls, cells: int) -> "AxisSolver":
        basis = cubic_basis(cells)
        dense = basis.dense()
        normal = dense.T @ dense
        banded = np.zeros((4, len(normal)))
        for below in range(4):
            banded[below, : len(normal) - below] = np.diagonal(normal, -below)
        factor = cholesky_banded(banded, lower=True)
        factor[0] = 1.0 / factor[0]
        return cls(basis, _banded_rows(normal, 7), factor)

    def solve_normal(self, axis: int, right: FloatArray) -> None:
        """Apply (AᵀA)⁻¹ along one axis of a contiguous array, in place."""
        flat, _ = by_axis(right, axis)
        if flat.shape[2] > 1:
            solve_axis(self.factor.copy(), flat)
            return
        turned = np.ascontiguousarray(flat[:, :, 0].T)
        solve_axis(self.factor.copy(), turned[None])
        flat[:, :, 0] = turned.T


AxisSolvers = tuple[AxisSolver, AxisSolver, AxisSolver]


def fit_coefficients(samples: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """Fit (cx, cy, cz) coefficients to (sx, sy, sz) samples with the least sum of squared residuals."""
    for axis, solver in enumerate(solvers):
        samples = solver.basis.transposed_along(axis, samples)
    return _solved(samples, solvers)


def surface_weights(distance_mm: FloatArray, knot_spacing_mm: float) -> FloatArray:
    """Compute weights max(exp(−d²/2σ²), 0.01), σ = 0.3 knots, which favour the fit at the surface.

    Creases of the distance map pull an unweighted fit off the surface: its medial axis, and the grooves of
    the surface, where that axis touches it.
    """
    weights = np.full(distance_mm.shape, FAR_WEIGHT)
    near = np.abs(distance_mm) < WEIGHTED_KNOTS * knot_spacing_mm
    weights[near] = np.exp(-0.5 * (distance_mm[near] / (SIGMA_KNOTS * knot_spacing_mm)) ** 2)
    return weights


def fit_weighted(samples: FloatArray, weights: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """Fit (cx, cy, cz) coefficients c that minimise Σ w (d − A c)² to samples d (sx, sy, sz) on a grid.

    Conjugate gradients on AᵀWA c = AᵀW d, preconditioned with (AᵀA)⁻¹ and started from the unweighted fit;
    the eigenvalues lie between the smallest and the largest weight. Ends when the preconditioned residual has
    fallen to 5 % of what the unweighted fit leaves, or after 40 steps.

    Most samples have the smallest weight w₀: AᵀWA = w₀ AᵀA + Bᵀ(W − w₀)B with B the rows of A of the others,
    and the unweighted residual r has Aᵀr = 0, so that a step visits the samples near the surface only.

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
    smallest = float(weights.min())
    at = np.nonzero(weights > smallest)
    near = _NearSamples(solvers, np.stack(at), unweighted.shape)
    extra = weights[at] - smallest
    change = conjugate_gradients(
        lambda c: smallest * _normal(c, solvers) + near.adjoint(extra * near.values(c)),
        near.adjoint(extra * (samples[at] - near.values(unweighted))),
        lambda r: _solved(r.copy(), solvers),
        tolerance=TOLERANCE,
        max_iterations=MAX_ITERATIONS,
    )
    return np.asarray(unweighted + change.x)


class _NearSamples:
    """Rows of A that belong to some of the samples: values of the spline there, and the adjoint."""

    def __init__(self, solvers: AxisSolvers, nodes: IntArray, shape: tuple[int, ...]) -> None:
        x, y, z = (AxisRows(s.basis.first.copy(), s.basis.weights.copy()) for s in solvers)
        self._axes, self._nodes, self._shape = (x, y, z), nodes, shape

    def values(self, coefficients: FloatArray) -> FloatArray:
        out = np.empty(self._nodes.shape[1])
        values_at_nodes(*self._axes, coefficients, self._nodes, out)
        return out

    def adjoint(self, values: FloatArray) -> FloatArray:
        out = np.zeros(self._shape)
        add_from_nodes(*self._axes, values, self._nodes, out)
        return out


def _normal(coefficients: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """AᵀA c."""
    for axis, solver in enumerate(solvers):
        coefficients = solver.normal.along(axis, coefficients)
    return coefficients


def _solved(right: FloatArray, solvers: AxisSolvers) -> FloatArray:
    """Apply (AᵀA)⁻¹ to an array in place."""
    for axis, solver in enumerate(solvers):
        solver.solve_normal(axis, right)
    return right


def _banded_rows(matrix: FloatArray, window: int) -> BandedRows:
    """Convert a square banded matrix to rows, each with the `window` entries about the diagonal."""
    count = len(matrix)
    width = min(window, count)
    first = np.clip(np.arange(count) - window // 2, 0, count - width)
    return BandedRows(first, np.take_along_axis(matrix, first[:, None] + np.arange(width), axis=1), count)


def sample_grid(reference: Sequence[Mesh], frame: str, knot_spacing_mm: float, margin_mm: float) -> Grid:
    """Lay samples at half the knot pitch over everything the surfaces sweep, plus the margin."""
    lower = np.min([mesh.vertices_mm.min(axis=0) for mesh in reference], axis=0) - margin_mm
    upper = np.max([mesh.vertices_mm.max(axis=0) for mesh in reference], axis=0) + margin_mm
    cells = 2 * np.ceil((upper - lower) / (2.0 * knot_spacing_mm)).astype(int)
    origin = 0.5 * (lower + upper) - 0.5 * cells * knot_spacing_mm
    shape = tuple(int(n) * SAMPLES_PER_KNOT + 1 for n in cells)
    return Grid.axis_aligned(
        frame, (shape[0], shape[1], shape[2]), origin, knot_spacing_mm / SAMPLES_PER_KNOT
    )


def axis_solvers(grid: Grid) -> AxisSolvers:
    """Prepare least squares along each axis of a sample grid."""
    x, y, z = (AxisSolver.of((n - 1) // SAMPLES_PER_KNOT) for n in grid.shape)
    return x, y, z


def fit_phase(mesh: Mesh, grid: Grid, solvers: AxisSolvers, band_mm: float) -> FloatArray:
    """Fit (cx, cy, cz) spline coefficients in mm to the signed distance, best at the surface."""
    samples = signed_distance_mm(mesh, grid, band_mm)
    knot_spacing_mm = SAMPLES_PER_KNOT * float(grid.spacing_mm[0])
    return fit_weighted(samples, surface_weights(samples, knot_spacing_mm), solvers)
