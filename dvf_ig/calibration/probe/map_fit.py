"""Levenberg–Marquardt fit of an image map, together with the unknowns of the phantom that it shows.

Why not scipy.optimize.least_squares: rotations, pixel sizes and a plane's normal are stepped along the
tangent of the current estimate. Linearised again about every accepted estimate, the derivatives are exact and
short. One fixed vector of parameters would also need those of the exponential map and of the plane's chart,
and its steps from far starts could not be bounded to one radian and a factor e, as they are here.
"""

from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from dvf_ig.core import FloatArray, ImageMap

from .map_parameters import MapParameters, with_square_pixels
from .tracked_points import TrackedPoints

MAX_STEPS = 60
MAX_DAMPINGS = 12
"""Times that the damping is raised tenfold for one step."""
CONVERGED_STEP = 1e-9
"""Length of the last step, in rad, mm and logarithms of sizes."""


class Phantom(Protocol):
    """Phantom at rest in the poses' target frame, with its residuals and its own unknowns."""

    def residuals(self, image_map: ImageMap, points: TrackedPoints) -> FloatArray:
        """Compute (f, r) residuals of each frame, mm or in units of their standard deviation."""

    def jacobian(self, parameters: MapParameters, points: TrackedPoints) -> FloatArray:
        """Compute (f, r, count + u) derivatives by the map's parameters, then by the phantom's u unknowns."""

    def stepped(self, step: FloatArray) -> Self:
        """Return the phantom a (u,) step away."""


P = TypeVar("P", bound=Phantom)


@dataclass(frozen=True, slots=True, eq=False)
class MapFit(Generic[P]):
    """One state of the search.

    Attributes:
        parameters: about the current map.
        phantom: with its current unknowns.
        cost: sum of squared residuals.
        converged: the last step was shorter than CONVERGED_STEP, or none lowers the cost.
    """

    parameters: MapParameters
    phantom: P
    cost: float = np.inf
    converged: bool = False

    def residuals(self, points: TrackedPoints) -> FloatArray:
        """(f, r)."""
        return self.phantom.residuals(self.parameters.estimate, points)

    def lengths(self, points: TrackedPoints) -> FloatArray:
        """(f,) length of each frame's residual."""
        return np.asarray(np.linalg.norm(self.residuals(points), axis=1))

    def stepped(self, step: FloatArray) -> "MapFit[P]":
        """Return the state a (count + u,) step away; rotations are cut at 1 rad, sizes at a factor e."""
        parameters, bounded = self.parameters, step.copy()
        angle = float(np.linalg.norm(step[:3]))
        if angle > 1.0:
            bounded[:3] /= angle
        bounded[6 : parameters.count] = np.clip(step[6 : parameters.count], -1.0, 1.0)
        moved = parameters.stepped(bounded[: parameters.count])
        return MapFit(
            MapParameters(moved, parameters.center_px, parameters.isotropic),
            self.phantom.stepped(bounded[parameters.count :]),
        )


def start_fit(image_map: ImageMap, phantom: P, points: TrackedPoints, *, isotropic: bool) -> MapFit[P]:
    """Build the first state; shifts are those of the middle of the region in which points were seen."""
    center = points.center_px
    start = with_square_pixels(image_map, center) if isotropic else image_map
    return MapFit(MapParameters(start, center, isotropic), phantom)


def levenberg_marquardt(
    start: MapFit[P], points: TrackedPoints, *, damping: float = 1e-4, steps: int = MAX_STEPS
) -> MapFit[P]:
    """Minimise the squared residuals near a start, linearising again about every accepted state.

    Args:
        start: where the search begins.
        points: the frames that are fitted.
        damping: of the first step; with 0, for a start near the solution, steps are those of Gauss and Newton
            as long as they lower the cost.
        steps: most steps taken.
    Source: Marquardt 1963 (damping in proportion to the diagonal of the normal equations).
    """
    state, converged = start, False
    residuals = state.residuals(points).ravel()
    cost = float(residuals @ residuals)
    for _ in range(steps):
        jacobian = state.phantom.jacobian(state.parameters, points).reshape(residuals.size, -1)
        for _ in range(MAX_DAMPINGS):
            step = _damped_step(jacobian, residuals, damping)
            trial = state.stepped(step)
            moved = trial.residuals(points).ravel()
            lowered = float(moved @ moved)
            if lowered <= cost * (1 + 1e-12) + 1e-20:
                break
            damping = max(10 * damping, 1e-4)
        else:
            converged = _at_minimum(jacobian, residuals)
            break
        state, residuals, cost, damping = trial, moved, lowered, damping / 10
        if np.linalg.norm(step) < CONVERGED_STEP:
            converged = True
            break
    return MapFit(state.parameters, state.phantom, cost, converged)


def _at_minimum(jacobian: FloatArray, residuals: FloatArray) -> bool:
    """Return whether the residuals are orthogonal to all that the parameters could change, to rounding."""
    step = np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
    explained = jacobian @ step
    return bool(explained @ explained <= 1e-9 * (residuals @ residuals) + 1e-20)


def _damped_step(jacobian: FloatArray, residuals: FloatArray, damping: float) -> FloatArray:
    """Compute the step that minimises |J s + r|² + damping · Σ (J'J)ᵢᵢ sᵢ², by orthogonal factorisation."""
    if damping > 0:
        square = np.square(jacobian).sum(axis=0)
        weights = np.sqrt(damping * square + 1e-12 * square.sum())
        jacobian = np.concatenate([jacobian, np.diag(weights)])
        residuals = np.concatenate([residuals, np.zeros(len(weights))])
    return np.asarray(np.linalg.lstsq(jacobian, -residuals, rcond=None)[0], dtype=np.float64)
