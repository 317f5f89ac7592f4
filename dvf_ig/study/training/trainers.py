"""Spline network and its training (Ren 2008, eqs 1 to 3): exact, by gradient descent, by conjugate gradients.

All minimise Σ (d − Σ p B C D)² (eq. 2). The paper descends along the gradient (eq. 3, `train_gradient`); on
a grid the minimum separates by axis and is found exactly (`train_separable`); samples anywhere are fitted
by conjugate gradients (`train_scattered`). Models are fitted by `dvf_ig.preop.spline.fit`; these trainers
are for comparison, and for networks of other degrees and pitches.

The minimum is unique only if the samples determine every direction of the network: each basis function
needs samples in its support, and no combination of basis functions may vanish at every sample. All trainers
refuse samples for which this does not hold.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from dvf_ig.core import FloatArray, InvalidInputError, Stop, read_only_arrays
from dvf_ig.core.arrays import check_shape
from dvf_ig.preop import Solution, conjugate_gradients

DEGREES = range(1, 6)


@dataclass(frozen=True, slots=True)
class SplineAxis:
    """Uniform B-splines along one axis, defined on `cells` whole cells.

    Attributes:
        degree: 1 (linear) to 5.
        origin_mm: start of the first cell.
        spacing_mm: knot pitch.
        cells: number of cells; there are cells + degree basis functions.
    """

    degree: int
    origin_mm: float
    spacing_mm: float
    cells: int

    def __post_init__(self) -> None:
        if self.degree not in DEGREES:
            raise InvalidInputError(f"spline degree is {self.degree}; choose {DEGREES[0]} to {DEGREES[-1]}")
        if not self.spacing_mm > 0.0 or not np.isfinite([self.spacing_mm, self.origin_mm]).all():
            raise InvalidInputError(
                f"knots start at {self.origin_mm:g} mm every {self.spacing_mm:g} mm; needed a finite start "
                "and a positive pitch"
            )
        if self.cells < 1:
            raise InvalidInputError(f"{self.cells} knot cells along an axis; needed at least 1")

    @property
    def functions(self) -> int:
        return self.cells + self.degree

    @property
    def upper_mm(self) -> float:
        return self.origin_mm + self.cells * self.spacing_mm

    def values(self, x_mm: FloatArray) -> csr_array:
        """(n, functions) value of every basis function at (n,) positions.

        Raises:
            InvalidInputError: a position outside the cells.
        """
        knots = np.arange(-self.degree, self.cells + self.degree + 1, dtype=np.float64)
        return csr_array(BSpline.design_matrix(self._knot_coordinates(x_mm), knots, self.degree))

    def _knot_coordinates(self, x_mm: FloatArray) -> FloatArray:
        """(n,) positions in knots from the origin; rounding errors at either end are tolerated."""
        u = (np.asarray(x_mm, dtype=np.float64) - self.origin_mm) / self.spacing_mm
        tolerance = 1e-9 * self.cells
        if not ((u >= -tolerance) & (u <= self.cells + tolerance)).all():
            raise InvalidInputError(
                f"positions from {np.min(x_mm):g} to {np.max(x_mm):g} mm; the spline is defined from "
                f"{self.origin_mm:g} to {self.upper_mm:g} mm"
            )
        return np.clip(u, 0.0, self.cells)


@dataclass(frozen=True, slots=True)
class SplineNetwork:
    """Three axes; coefficients are arrays of `shape`."""

    x: SplineAxis
    y: SplineAxis
    z: SplineAxis

    @property
    def axes(self) -> tuple[SplineAxis, SplineAxis, SplineAxis]:
        return self.x, self.y, self.z

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.x.functions, self.y.functions, self.z.functions

    def design(self, xyz_mm: FloatArray) -> csr_array:
        """(n, functions) value of every product of basis functions at (n, 3) points, in `ravel` order."""
        check_shape(np.asarray(xyz_mm), "points", (None, 3))
        n = len(xyz_mm)
        columns, values = np.zeros((n, 1), dtype=np.int64), np.ones((n, 1))
        for a, axis in enumerate(self.axes):
            matrix = axis.values(xyz_mm[:, a])
            index = matrix.indices.reshape(n, -1).astype(np.int64)
            columns = (columns[:, :, None] * axis.functions + index[:, None]).reshape(n, -1)
            values = (values[:, :, None] * matrix.data.reshape(n, -1)[:, None]).reshape(n, -1)
        rows = np.repeat(np.arange(n), columns.shape[1])
        return csr_array((values.ravel(), (rows, columns.ravel())), shape=(n, int(np.prod(self.shape))))


MIN_EIGENVALUE_SHARE = 1e-10
"""Directions with a smaller eigenvalue of the Gram matrix, as a share of the largest, are undetermined."""

PROBE_TOLERANCE = 1e-4
"""Largest relative error with which a known network must be recovered from its own values at the samples."""

OnIteration = Callable[[FloatArray], None]
"""Called with the coefficients after every iteration."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """A trained network and how its training ended.

    Attributes:
        coefficients: of the network's shape, in the unit of the samples.
        stop: CONVERGED, or MAX_ITERATIONS.
        iterations: steps taken; 0 for the exact solution.
        rms: root mean square residual at the samples.
    """

    coefficients: FloatArray
    stop: Stop
    iterations: int
    rms: float


def train_separable(
    network: SplineNetwork, positions_mm: tuple[FloatArray, FloatArray, FloatArray], samples: FloatArray
) -> Trained:
    """Exact minimiser for samples on a grid: three 1-D least squares, one after the other.

    AᵀA is the Kronecker product of the axes' Gram matrices, hence so is its inverse.

    Args:
        positions_mm: (s,) sample positions along each axis, of any spacing.
        samples: (sx, sy, sz).
    Raises:
        InvalidInputError: shapes that do not fit, or samples that leave a direction of the network
            undetermined.
    """
    bases = _bases(network, positions_mm, samples)
    solved = samples
    for basis, gram in zip(bases, _grams(network, bases), strict=True):
        projected = basis.T @ solved.reshape(len(solved), -1)
        along = cho_solve(cho_factor(gram), projected).reshape(-1, *solved.shape[1:])
        solved = np.moveaxis(along, 0, -1)
    return Trained(solved, Stop.CONVERGED, 0, _rms(samples - _apply(bases, solved)))


def safe_step(
    network: SplineNetwork, positions_mm: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[float, float]:
    """The step 1/L and the condition number L/μ of the quadratic on a grid.

    ½‖d − A p‖² has the gradient Aᵀ(A p − d), Lipschitz with L = λ_max(AᵀA). On a grid AᵀA is a Kronecker
    product, so its eigenvalues are the products of the three axes' ones: L and μ are the products of the
    largest and of the smallest. A step of 1/L never increases the sum, and shrinks the distance to the
    minimiser by at least 1 − μ/L; any step below 2/L converges, any above diverges.
    """
    extremes = [np.linalg.eigvalsh(g)[[0, -1]] for g in _grams(network, _axis_bases(network, positions_mm))]
    smallest, largest = np.prod(extremes, axis=0)
    return 1.0 / float(largest), float(largest / smallest)


def train_gradient(
    network: SplineNetwork,
    positions_mm: tuple[FloatArray, FloatArray, FloatArray],
    samples: FloatArray,
    *,
    tolerance: float = 1e-9,
    max_iterations: int = 20_000,
    on_iteration: OnIteration = lambda _: None,
) -> Trained:
    """The paper's gradient descent (eq. 3) from zero, with the step 1/L of `safe_step`.

    Args:
        tolerance: ends when the gradient has fallen to this share of the first one.
        max_iterations: a network of pitch close to the samples' has a condition number in the thousands, and
            needs about that many steps for each factor of e.
        on_iteration: called with the coefficients after every step.
    Raises:
        InvalidInputError: as train_separable.
    """
    bases = _bases(network, positions_mm, samples)
    step, _ = safe_step(network, positions_mm)
    coefficients = np.zeros(network.shape)
    right = _apply([basis.T for basis in bases], samples)
    grams = _grams(network, bases)
    limit = tolerance * float(np.linalg.norm(right))
    stop, count = Stop.MAX_ITERATIONS, max_iterations
    for i in range(max_iterations):
        downhill = right - _apply(grams, coefficients)
        if np.linalg.norm(downhill) <= limit:
            stop, count = Stop.CONVERGED, i
            break
        coefficients = coefficients + step * downhill
        on_iteration(coefficients)
    return Trained(coefficients, stop, count, _rms(samples - _apply(bases, coefficients)))


def train_scattered(
    network: SplineNetwork,
    xyz_mm: FloatArray,
    samples: FloatArray,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 5_000,
    on_iteration: OnIteration | None = None,
) -> Trained:
    """Conjugate gradients on AᵀA p = Aᵀd for samples anywhere, Jacobi preconditioned.

    Args:
        xyz_mm: (n, 3) positions; samples: (n,) values there.
        tolerance: ends when the preconditioned residual has fallen to this share of the first one.
        on_iteration: called with the coefficients, (functions,) in `ravel` order, after every step.
    Raises:
        InvalidInputError: shapes that do not fit, or samples that leave the network undetermined.
    """
    check_shape(np.asarray(xyz_mm), "sample positions", (None, 3))
    check_shape(np.asarray(samples), "samples", (len(xyz_mm),))
    design = network.design(xyz_mm)
    gram = csr_array(design.T @ design)
    _require_determined(gram, tolerance, max_iterations)
    solved = _solved(gram, design.T @ samples, tolerance, max_iterations, on_iteration)
    residual = samples - design @ solved.x
    return Trained(solved.x.reshape(network.shape), solved.stop, solved.iterations, _rms(residual))


def _solved(
    gram: csr_array,
    right: FloatArray,
    tolerance: float,
    max_iterations: int,
    on_iteration: OnIteration | None = None,
) -> Solution:
    """G p = r, preconditioned with the diagonal."""
    inverse = 1.0 / gram.diagonal()
    return conjugate_gradients(
        lambda p: np.asarray(gram @ p),
        right,
        lambda r: np.asarray(inverse * r),
        tolerance=tolerance,
        max_iterations=max_iterations,
        on_iteration=on_iteration,
    )


def _require_determined(gram: csr_array, tolerance: float, max_iterations: int) -> None:
    """Refuse samples that do not determine the network.

    Two tests: every basis function has samples in its support; and a known network, trained on its own values
    at the samples, is recovered. Started from zero, conjugate gradients never enter the null space of the
    Gram matrix, so the part of the known network that the samples do not determine is missing from the
    result.
    """
    energy = gram.diagonal()
    unsupported = int(np.count_nonzero(energy <= MIN_EIGENVALUE_SHARE * energy.max()))
    if unsupported:
        raise InvalidInputError(
            f"{unsupported} of {len(energy)} basis functions have no samples in their support: the "
            "minimum is not unique; add samples there, or widen the knots"
        )
    reference = np.cos(np.arange(len(energy), dtype=np.float64) ** 2)
    recovered = _solved(gram, gram @ reference, tolerance, max_iterations).x
    missing = float(np.linalg.norm(recovered - reference) / np.linalg.norm(reference))
    if missing > PROBE_TOLERANCE:
        raise InvalidInputError(
            f"the samples do not determine the network: a known one is recovered with an error of "
            f"{missing:.1%}; add samples or widen the knots"
        )


def _axis_bases(
    network: SplineNetwork, positions_mm: tuple[FloatArray, FloatArray, FloatArray]
) -> list[FloatArray]:
    return [axis.values(x).toarray() for axis, x in zip(network.axes, positions_mm, strict=True)]


def _bases(
    network: SplineNetwork, positions_mm: tuple[FloatArray, FloatArray, FloatArray], samples: FloatArray
) -> list[FloatArray]:
    """Values of each axis' basis at its sample positions, after a check of the shapes."""
    check_shape(samples, "samples on a grid", tuple(len(x) for x in positions_mm))
    return _axis_bases(network, positions_mm)


def _grams(network: SplineNetwork, bases: list[FloatArray]) -> list[FloatArray]:
    """BᵀB of each axis; a singular one is refused."""
    grams = [basis.T @ basis for basis in bases]
    for axis, gram in zip(network.axes, grams, strict=True):
        eigenvalues = np.linalg.eigvalsh(gram)
        undetermined = int(np.count_nonzero(eigenvalues <= MIN_EIGENVALUE_SHARE * eigenvalues[-1]))
        if undetermined:
            raise InvalidInputError(
                f"the samples leave {undetermined} of {axis.functions} directions of an axis of degree "
                f"{axis.degree} undetermined: the minimum is not unique; add samples or widen the knots"
            )
    return grams


def _apply(matrices: list[FloatArray], array: FloatArray) -> FloatArray:
    """Each matrix along its axis."""
    for matrix in matrices:
        along = (matrix @ array.reshape(len(array), -1)).reshape(-1, *array.shape[1:])
        array = np.moveaxis(along, 0, -1)
    return array


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt(np.mean(residual**2)))
