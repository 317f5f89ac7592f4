"""Three ways to the minimum of Σ (d − Σ p B C D)²: exact, the paper's gradient descent, conjugate gradients.

The minimum is unique only if the samples excite every direction of the network: each basis function needs
samples under it, and no combination of them may vanish at every sample. All trainers refuse samples that do
not, unless a ridge makes the quadratic strictly convex.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from dvf_ig.core import FloatArray, InvalidInputError, Stop, read_only_arrays
from dvf_ig.core.arrays import check_shape

from .network import SplineNetwork

SINGULAR = 1e-10
"""Smallest eigenvalue of a Gram matrix, as a share of the largest, that counts as excited."""

PROBE_TOLERANCE = 1e-4
"""How closely a known network must come back from its own values at the samples."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """A trained network.

    Attributes:
        coefficients: of the network's shape, in the unit of the samples.
        stop: CONVERGED, or MAX_ITERATIONS.
        iterations: steps taken; 0 for the exact solution.
        rms: root mean square of what is left at the samples.
    """

    coefficients: FloatArray
    stop: Stop
    iterations: int
    rms: float


def train_separable(
    network: SplineNetwork, places_mm: tuple[FloatArray, FloatArray, FloatArray], samples: FloatArray
) -> Trained:
    """Exact minimiser for samples on a grid: three 1-D least squares, one after the other.

    AᵀA is the Kronecker product of the axes' Gram matrices, hence so is its inverse.

    Args:
        places_mm: (s,) sample places along each axis, of any spacing.
        samples: (sx, sy, sz).
    Raises:
        InvalidInputError: shapes that do not fit, or places that do not excite every basis function.
    """
    bases = _bases(network, places_mm, samples)
    solved = samples
    for basis, gram in zip(bases, _grams(network, bases), strict=True):
        projected = basis.T @ solved.reshape(len(solved), -1)
        along = cho_solve(cho_factor(gram), projected).reshape(-1, *solved.shape[1:])
        solved = np.moveaxis(along, 0, -1)
    return Trained(solved, Stop.CONVERGED, 0, _rms(samples - _apply(bases, solved)))


def safe_step(
    network: SplineNetwork, places_mm: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[float, float]:
    """1/L and the condition number L/μ of the quadratic on a grid.

    ½‖d − A p‖² has the gradient Aᵀ(A p − d), Lipschitz with L = λ_max(AᵀA). On a grid AᵀA is a Kronecker
    product, so its eigenvalues are the products of the three axes' ones: L and μ are the products of the
    largest and of the smallest. A step of 1/L never increases the sum, and shrinks the distance to the
    minimiser by at least 1 − μ/L; any step below 2/L converges, any above diverges.
    """
    extremes = [np.linalg.eigvalsh(g)[[0, -1]] for g in _grams(network, _axis_bases(network, places_mm))]
    smallest, largest = np.prod(extremes, axis=0)
    return 1.0 / float(largest), float(largest / smallest)


def train_gradient(
    network: SplineNetwork,
    places_mm: tuple[FloatArray, FloatArray, FloatArray],
    samples: FloatArray,
    *,
    tolerance: float = 1e-9,
    max_iterations: int = 20_000,
) -> Trained:
    """The paper's gradient descent (eq. 3) from zero, with the safe step 1/L.

    Args:
        tolerance: ends when the gradient has fallen to this share of the first one.
        max_iterations: a network of pitch close to the samples' has a condition number in the thousands, and
            needs about that many steps for each factor of e.
    Raises:
        InvalidInputError: as train_separable.
    """
    bases = _bases(network, places_mm, samples)
    step, _ = safe_step(network, places_mm)
    coefficients = np.zeros(network.shape)
    right = _project(bases, samples)
    grams = _grams(network, bases)
    wanted = tolerance * float(np.linalg.norm(right))
    stop, count = Stop.MAX_ITERATIONS, max_iterations
    for i in range(max_iterations):
        downhill = right - _apply(grams, coefficients)
        if np.linalg.norm(downhill) <= wanted:
            stop, count = Stop.CONVERGED, i
            break
        coefficients = coefficients + step * downhill
    return Trained(coefficients, stop, count, _rms(samples - _apply(bases, coefficients)))


def train_scattered(
    network: SplineNetwork,
    xyz_mm: FloatArray,
    samples: FloatArray,
    *,
    weights: FloatArray | None = None,
    ridge: float = 0.0,
    tolerance: float = 1e-10,
    max_iterations: int = 5_000,
) -> Trained:
    """Conjugate gradients on (AᵀWA + ridge·I) p = AᵀW d for samples anywhere, Jacobi preconditioned.

    Args:
        xyz_mm: (n, 3) places; samples: (n,) values there.
        weights: (n,) positive; None: all 1.
        ridge: 0, or a positive pull of every coefficient towards 0 that makes the minimum unique.
        tolerance: ends when the preconditioned residual has fallen to this share of the first one.
    Raises:
        InvalidInputError: shapes that do not fit, or, without a ridge, samples that leave the network
            undetermined.
    """
    check_shape(np.asarray(xyz_mm), "sample places", (None, 3))
    check_shape(np.asarray(samples), "samples", (len(xyz_mm),))
    w = np.ones(len(xyz_mm)) if weights is None else np.asarray(weights, dtype=np.float64)
    check_shape(w, "sample weights", (len(xyz_mm),))
    if not (w > 0.0).all() or not ridge >= 0.0:
        raise InvalidInputError("sample weights must be positive, and a ridge must not be negative")
    design = network.design(xyz_mm)
    gram = csr_array(design.T @ (design * w[:, None]))
    if ridge == 0.0:
        _require_determined(gram, tolerance, max_iterations)
    else:
        gram = gram + ridge * csr_array((np.ones(gram.shape[0]), (np.arange(gram.shape[0]),) * 2))
    solved, stop, count = _conjugate(gram, design.T @ (w * samples), tolerance, max_iterations)
    left = samples - design @ solved
    return Trained(solved.reshape(network.shape), stop, count, _rms(left))


def _conjugate(
    gram: csr_array, right: FloatArray, tolerance: float, max_iterations: int
) -> tuple[FloatArray, Stop, int]:
    """Solve G p = r from zero."""
    inverse = 1.0 / gram.diagonal()
    solved, residual = np.zeros_like(right), right.copy()
    direction = inverse * residual
    norm = start = float(residual @ direction)
    for count in range(max_iterations):
        if norm <= tolerance**2 * start:
            return solved, Stop.CONVERGED, count
        image = gram @ direction
        step = norm / float(direction @ image)
        solved += step * direction
        residual -= step * image
        previous, norm = norm, float(residual @ (inverse * residual))
        direction = inverse * residual + (norm / previous) * direction
    return solved, Stop.MAX_ITERATIONS, max_iterations


def _require_determined(gram: csr_array, tolerance: float, max_iterations: int) -> None:
    """Refuse samples from which a network cannot be told.

    Two tests: no basis function without samples; and a known network, trained on its own values at the
    samples, must come back. From zero, conjugate gradients never enter the null space of the Gram matrix, so
    whatever part of the known network the samples do not show is missing from what comes back.
    """
    energy = gram.diagonal()
    silent = int(np.count_nonzero(energy <= SINGULAR * energy.max()))
    if silent:
        raise InvalidInputError(
            f"the samples leave {silent} of {len(energy)} basis functions without any: the minimum is not "
            "unique; add samples there, widen the knots, or give a ridge"
        )
    known = np.cos(np.arange(len(energy), dtype=np.float64) ** 2)
    back, _, _ = _conjugate(gram, gram @ known, tolerance, max_iterations)
    missing = float(np.linalg.norm(back - known) / np.linalg.norm(known))
    if missing > PROBE_TOLERANCE:
        raise InvalidInputError(
            f"the samples do not determine the network: a known one comes back with {missing:.1%} missing; "
            "add samples, widen the knots, or give a ridge"
        )


def _axis_bases(
    network: SplineNetwork, places_mm: tuple[FloatArray, FloatArray, FloatArray]
) -> list[FloatArray]:
    return [axis.values(x).toarray() for axis, x in zip(network.axes, places_mm, strict=True)]


def _bases(
    network: SplineNetwork, places_mm: tuple[FloatArray, FloatArray, FloatArray], samples: FloatArray
) -> list[FloatArray]:
    """Values of each axis' basis at its sample places, after a look at the shapes."""
    check_shape(samples, "samples on a grid", tuple(len(x) for x in places_mm))
    return _axis_bases(network, places_mm)


def _grams(network: SplineNetwork, bases: list[FloatArray]) -> list[FloatArray]:
    """BᵀB of each axis; refuses a singular one."""
    grams = [basis.T @ basis for basis in bases]
    for axis, gram in zip(network.axes, grams, strict=True):
        eigenvalues = np.linalg.eigvalsh(gram)
        lost = int(np.count_nonzero(eigenvalues <= SINGULAR * eigenvalues[-1]))
        if lost:
            raise InvalidInputError(
                f"the sample places leave {lost} of {axis.functions} directions of an axis of degree "
                f"{axis.degree} unexcited: the minimum is not unique; add samples or widen the knots"
            )
    return grams


def _apply(matrices: list[FloatArray], array: FloatArray) -> FloatArray:
    """Each matrix along its axis."""
    for matrix in matrices:
        along = (matrix @ array.reshape(len(array), -1)).reshape(-1, *array.shape[1:])
        array = np.moveaxis(along, 0, -1)
    return array


def _project(bases: list[FloatArray], samples: FloatArray) -> FloatArray:
    """Aᵀ of samples on a grid."""
    return _apply([basis.T for basis in bases], samples)


def _rms(left: FloatArray) -> float:
    return float(np.sqrt(np.mean(left**2)))
