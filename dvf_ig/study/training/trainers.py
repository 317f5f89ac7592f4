"""Training of the spline network (Ren 2008, eqs 2 and 3): exact, by gradient descent, by conjugate gradients.

All minimise Σ (d − Σ p B C D)² (eq. 2). The paper descends along the gradient (eq. 3, `train_gradient`); on a
grid the minimum separates by axis and is found exactly (`train_separable`); samples anywhere are fitted by
conjugate gradients (`train_scattered`). Models are fitted by `dvf_ig.preop.spline.fit`; these trainers are
for comparison, and for networks of other degrees and pitches.

The minimum is unique only if the samples determine every direction of the network: each basis function needs
samples in its support, and no combination of basis functions may vanish at every sample. All trainers refuse
samples for which this does not hold, unless a ridge makes the quadratic strictly convex.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from dvf_ig.core import FloatArray, InvalidInputError, Stop, read_only_arrays
from dvf_ig.core.arrays import check_shape
from dvf_ig.preop import Solution, conjugate_gradients

from .network import SplineNetwork

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
        on_iteration(coefficients)
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
    on_iteration: OnIteration | None = None,
) -> Trained:
    """Conjugate gradients on (AᵀWA + ridge·I) p = AᵀW d for samples anywhere, Jacobi preconditioned.

    Args:
        xyz_mm: (n, 3) positions; samples: (n,) values there.
        weights: (n,) positive; None: all 1.
        ridge: weight of Σ p²; a positive one makes the minimum unique.
        tolerance: ends when the preconditioned residual has fallen to this share of the first one.
        on_iteration: called with the coefficients, (functions,) in `ravel` order, after every step.
    Raises:
        InvalidInputError: shapes that do not fit, or, without a ridge, samples that leave the network
            undetermined.
    """
    check_shape(np.asarray(xyz_mm), "sample positions", (None, 3))
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
    solved = _solved(gram, design.T @ (w * samples), tolerance, max_iterations, on_iteration)
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
            "minimum is not unique; add samples there, widen the knots, or give a ridge"
        )
    known = np.cos(np.arange(len(energy), dtype=np.float64) ** 2)
    recovered = _solved(gram, gram @ known, tolerance, max_iterations).x
    missing = float(np.linalg.norm(recovered - known) / np.linalg.norm(known))
    if missing > PROBE_TOLERANCE:
        raise InvalidInputError(
            f"the samples do not determine the network: a known one is recovered with an error of "
            f"{missing:.1%}; add samples, widen the knots, or give a ridge"
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


def _project(bases: list[FloatArray], samples: FloatArray) -> FloatArray:
    """Aᵀ of samples on a grid."""
    return _apply([basis.T for basis in bases], samples)


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt(np.mean(residual**2)))
