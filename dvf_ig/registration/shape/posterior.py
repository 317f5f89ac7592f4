"""How the heart has changed its shape, from boundary points: modes with their covariance and evidence.

A boundary point that lies at y at the registered pose belongs to q' = y + X(y) ξ − B(y) z in the model: ξ a
small rigid motion, B(y) z the change of shape in modes (`modes`), z ~ N(0, s² I). Its residual is

    r = d(q') − o − N w

with d the distance of the model's boundary at the point's phase, o an offset common to all, and N w what
neighbouring points share of the boundary's own error: a second process along the normal, smooth over
SHARED_OVER_MM, of w ~ N(0, I) on a lattice. (With one weight for all points instead, the evidence is blind.)
ξ, o, z and w are fitted together by Gauss–Newton with the weights of Geman and McClure; then w is integrated
out. Evidence is that of Laplace (MacKay 1992).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from dvf_ig.core import FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.kernels.boundary import DistanceSplines, boundary_distances
from dvf_ig.registration.boundary.fit import Boundary, BoundaryProblem
from dvf_ig.registration.pose_chart import rigid_motion

from .modes import ShapeModes

NOISE_MM = 0.9
"""Standard deviation of a point's own error along the normal."""
SHARED_MM, SHARED_OVER_MM = 0.7, 12.0
"""Standard deviation and length of the error that points share. At the true pose and shape of tuning heart
1001 residuals of points of different frames have a covariance of 0.3 mm² up to 6 mm apart, half of that at 11
mm and none beyond 20; those of one frame have 0.7 mm² within 6 mm."""
POSE_SIGMA_MM = 3.0
OFFSET_SIGMA_MM = 0.5
OUTLIER_MM = 2.5
"""Residual at which a point counts a quarter."""
REACH_MM = 10.0
"""Points further from the model's boundary than this at the given pose do not count."""
POINTS = 1500
STEPS, FAR_STEPS = 6, 3
"""Most steps of a descent, and of a rigid one those with three times OUTLIER_MM."""
SETTLED_MM = 0.02
KERNEL_CUT = 2.5
"""Where the kernel of the shared error is cut, in its standard deviations."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShapePosterior:
    """Rigid motion and change of shape that explain the boundary best, and how well they are known.

    Attributes:
        state: (7 + k,) mm: ξ in the coordinates of `PoseChart`, offset, z.
        covariance_mm2: (7 + k, 7 + k) of the state.
        scale_mm: s; 0 if the heart was taken to be rigid.
        log_evidence: up to a constant that fits of one problem share.
        shared: mean square of the shared error's coefficients w, a priori 1.
    """

    state: FloatArray
    covariance_mm2: FloatArray
    scale_mm: float
    log_evidence: float
    shared: float


class ShapeProblem:
    """Boundary points that lie near the model's boundary at a pose.

    Attributes:
        places_mm: (n, 3) the points at the pose, target frame.
        outward: (n, 3) unit normals of the model's boundary there, from the blood to the wall.
    """

    def __init__(
        self, boundary: Boundary, offset_mm: float, pose: Rigid, modes: ShapeModes, count: int
    ) -> None:
        """Place the points and evaluate the modes at them.

        Args:
            offset_mm: of the points from the model's boundary, about which it is free.
            count: how many modes.
        """
        few = boundary.points.subsampled(POINTS)
        points = BoundaryProblem(Boundary(few, boundary.target), modes.center_mm).points
        self._splines = DistanceSplines(
            boundary.target.coefficients, boundary.target.knots_from_mm, boundary.target.polarity
        )
        places = pose.apply_array(points.points)
        distance, gradient = self._distance(places, points.phases)
        unit = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-6)
        outward = boundary.target.polarity * unit
        agreement = np.einsum("ni,ni->n", points.normals @ pose.rotation.T, outward)
        near = (np.abs(distance - offset_mm) < REACH_MM) & (agreement > 0.0)
        self.places_mm, self.outward = places[near], outward[near]
        self._phases, self._offset_mm = points.phases[near], offset_mm
        self._weight = points.weights[near] * agreement[near]
        self._motion = rigid_motion(self.places_mm, modes.center_mm)
        # modes at the feet of the points: at the points, a change that varies along the normal explains noise
        feet = self.places_mm - (distance - offset_mm)[near, None] * unit[near]
        self._modes = modes.at(feet, count)
        inside = np.einsum("ni,nik->nk", gradient[near], self._modes)
        every = modes.variance_along(feet, gradient[near])
        self._left_out = np.maximum(every - (inside**2).sum(axis=1), 0.0)
        self._shared = shared_error(points.points[near])

    def __len__(self) -> int:
        return len(self.places_mm)

    def _distance(self, places_mm: FloatArray, phases: IntArray) -> tuple[FloatArray, FloatArray]:
        """(n,) distance of the model's boundary and (n, 3) its gradient, 0 outside the splines."""
        distance, gradient = np.empty(len(places_mm)), np.empty((len(places_mm), 3))
        boundary_distances(self._splines, phases, places_mm, distance, gradient)
        return distance, gradient

    def fit(self, scale_mm: float, noise: float, begin: ShapePosterior | None = None) -> ShapePosterior:
        """Fit at one scale of the change of shape; 0 keeps the heart rigid.

        Args:
            noise: factor on NOISE_MM and SHARED_MM.
            begin: fit to begin at.
        """
        modes = self._modes if scale_mm > 0 else self._modes[:, :, :0]
        count, rows = modes.shape[2], noise * self._shared
        variance = (noise * NOISE_MM) ** 2 + scale_mm**2 * self._left_out
        prior = np.full(7 + count, max(scale_mm, 1e-3) ** -2.0)
        prior[:7] = [POSE_SIGMA_MM**-2] * 6 + [OFFSET_SIGMA_MM**-2]
        state, w = np.zeros(7 + count), np.zeros(rows.shape[1])
        if begin is not None:
            state[: len(begin.state)] = begin.state
        for step in range(STEPS):
            residual, columns = self._expansion(state, modes)
            residual = residual - rows @ w
            outlier = OUTLIER_MM * (3.0 if begin is None and step < FAR_STEPS else 1.0)
            near = 1.0 / (1.0 + (residual / outlier) ** 2)
            weight = self._weight / variance * near**2
            weighted = weight[:, None] * columns
            mixed = -(rows.T @ weighted)
            own = (rows.T @ rows.multiply(weight[:, None])).toarray() + np.eye(len(w))
            factor = cho_factor(own, lower=True, overwrite_a=True, check_finite=False)
            solved = cho_solve(
                factor, np.column_stack([mixed, w - rows.T @ (weight * residual)]), check_finite=False
            )
            reduced = columns.T @ weighted + np.diag(prior) - mixed.T @ solved[:, :-1]
            slope = weighted.T @ residual + prior * state
            change = -np.linalg.solve(reduced, slope - mixed.T @ solved[:, -1])
            state, w = state + change, w - solved[:, -1] - solved[:, :-1] @ change
            if np.linalg.norm(change[:6]) < SETTLED_MM and (begin is not None or step >= FAR_STEPS):
                break
        residual = self._expansion(state, modes)[0] - rows @ w
        near = 1.0 / (1.0 + (residual / OUTLIER_MM) ** 2)
        log_evidence = (
            -0.5 * float(self._weight @ (residual**2 / variance * near + np.log(variance)))
            - 0.5 * float(prior @ state**2 + w @ w - np.log(prior[7:]).sum())
            - 0.5 * float(np.linalg.slogdet(reduced)[1])
            - float(np.log(np.diag(factor[0])).sum())
        )
        shared = float(np.mean(w**2))
        return ShapePosterior(state, np.linalg.inv(reduced), scale_mm, log_evidence, shared)

    def misfit(self, fit: ShapePosterior) -> float:
        """Mean of the points' robust squared residuals by a fit, also one to other points."""
        residual = self._expansion(fit.state, self._modes[:, :, : len(fit.state) - 7])[0]
        near = 1.0 / (1.0 + (residual / OUTLIER_MM) ** 2)
        return float(self._weight @ (residual**2 * near) / self._weight.sum())

    def _expansion(self, state: FloatArray, modes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) residual without the shared error, and (n, 7 + k) its derivative by the state."""
        pulled = self.places_mm + self._motion @ state[:6] - modes @ state[7:]
        distance, gradient = self._distance(pulled, self._phases)
        columns = [
            np.einsum("ni,nip->np", gradient, self._motion),
            -np.ones((len(pulled), 1)),
            -np.einsum("ni,nik->nk", gradient, modes),
        ]
        return distance - self._offset_mm - state[6], np.concatenate(columns, axis=1)


def shared_error(points_mm: FloatArray) -> csr_array:
    """(n, l) N: the error that (n, 3) points share is N w, with w of independent standard normals.

    A kernel of width ℓ/√2 on a lattice gives a correlation over ℓ; each row has the length SHARED_MM.
    """
    cells = np.unique(np.floor(points_mm / SHARED_OVER_MM).astype(np.int64), axis=0)
    nodes = (cells + 0.5) * SHARED_OVER_MM
    width = SHARED_OVER_MM / np.sqrt(2.0)
    pairs = cKDTree(points_mm).sparse_distance_matrix(
        cKDTree(nodes), KERNEL_CUT * width, output_type="coo_matrix"
    )
    kernel = np.exp(-0.5 * (pairs.data / width) ** 2)
    length = np.sqrt(np.bincount(pairs.row, kernel**2, minlength=len(points_mm)))
    values = SHARED_MM * kernel / length[pairs.row]
    return csr_array((values, (pairs.row, pairs.col)), shape=(len(points_mm), len(nodes)))
