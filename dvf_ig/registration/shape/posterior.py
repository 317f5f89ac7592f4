"""How the heart has changed its shape, from boundary points: modes with their covariance and evidence.

A boundary point that lies at y at the registered pose belongs to q' = y + X(y) ξ − B(y) z in the model: ξ a
small rigid motion, B(y) z the change of shape in modes (`modes`), z ~ N(0, s² I). Its residual is

    r = d(q') − e − a (o + t τ) − N w

with d the distance of the model's boundary at the point's phase, e that of the place where smoothed images
would show it (`edges_of_model_mm`), a the cosine between its normal and the image's, o an offset common to
all, τ one of thin walls (t = exp(−depth/THIN_MM) less its mean), N w what neighbouring points share of the
boundary's own error: a second process along the normal, smooth over SHARED_OVER_MM, of w ~ N(0, I) on a
lattice. (With one weight for all points instead, the evidence is blind.) Points touched on the organ's outer
surface belong to it alone: d is its distance, and neither an edge, an offset nor a shared error theirs. All
are fitted together by
Gauss–Newton with the weights of Geman and McClure; then w is integrated out. Evidence is that of Laplace
(MacKay 1992).
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csr_array, vstack
from scipy.spatial import cKDTree

from dvf_ig.core import BoolArray, FloatArray, IntArray, Rigid, TouchedPoints, read_only_arrays
from dvf_ig.registration.boundary.fit import Boundary, BoundaryProblem
from dvf_ig.registration.boundary.points import edges_of_model_mm
from dvf_ig.registration.boundary.target import BoundaryTarget
from dvf_ig.registration.pose_chart import rigid_motion

from .blocks import BlockedMatch
from .modes import ShapeModes

NOISE_MM = 0.5
"""Standard deviation of a point's own error along the normal."""
SHARED_MM, SHARED_OVER_MM = 0.4, 12.0
"""Standard deviation and length of the error that points share. At the true pose and shape of threshold
hearts 2104 to 2107 residuals of points of different frames have a covariance of 0.06 to 0.26 mm² up to 3 mm
apart, half of that at 10 mm; 0.2 to 0.4 mm² without e and τ."""
POSE_SIGMA_MM = 3.0
OFFSET_SIGMA_MM, THIN_SIGMA_MM = 0.3, 2.0
THIN_MM = 6.0
"""Depth of the boundary in the organ over which the offset of thin walls decays: what lies behind a wall
moves its edge. In threshold hearts 2104 to 2107 o is 0.9 to 1.4 mm and τ −1.7 to −3.1 mm."""
FIXED = 8
"""Unknowns before those of the modes: six of the pose, o and τ."""
OUTLIER_MM = 1.25
"""Residual at which a point counts a quarter."""
REACH_MM = 10.0
"""Points further from the model's boundary than this at the given pose do not count."""
POINTS = 2500
CONTRACTION_SIGMA = 0.35
"""Standard deviation of how much further a heart contracts than in the MR, as a share."""
STEPS = 6
"""Most steps of a descent with OUTLIER_MM, unless fewer do."""
FAR = (3.0, 3.0, 3.0)
"""Factors on OUTLIER_MM in the first steps of a descent that begins at a rigid heart: walls may be far."""
CORRECTION_STEPS = 3
"""Most steps of a correction by the points of one beat."""
SETTLED_MM = 0.02
KERNEL_CUT = 2.5
"""Where the kernel of the shared error is cut, in its standard deviations."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShapePosterior:
    """Rigid motion and change of shape that explain the boundary best, and how well they are known.

    Attributes:
        state: (FIXED + k,) mm: ξ in the coordinates of `PoseChart`, o, τ, z.
        covariance_mm2: (FIXED + k, FIXED + k) of the state.
        scale_mm: s; 0 if the heart was taken to be rigid.
        log_evidence: up to a constant that fits of one problem share; of the boundary alone.
        shared: mean square of the shared error's coefficients w, a priori 1.
    """

    state: FloatArray
    covariance_mm2: FloatArray
    scale_mm: float
    log_evidence: float
    shared: float


@dataclass(frozen=True, slots=True, eq=False)
class SeenBoundary:
    """The boundary in the images, at a registered pose.

    Attributes:
        boundary: points, and the model's boundary.
        offset_mm: of the points from the model's boundary, about which it is free.
        pose: target_from_source.
        organ: outer surface, from which depths are measured; None: no wall counts as thin.
        touched: points touched on that surface; None without any.
    """

    boundary: Boundary
    offset_mm: float
    pose: Rigid
    organ: BoundaryTarget | None
    touched: TouchedPoints | None = None


class Level(NamedTuple):
    """Offset of the boundary and mean thinness of its walls, about which o and τ are free."""

    offset_mm: float
    thin: float


class ImagedBlocks:
    """Blocks of images that a change of shape displaces, by LC2."""

    def __init__(self, match: BlockedMatch, pose: Rigid, modes: ShapeModes, count: int) -> None:
        """Evaluate the first modes at the blocks of a match at a pose."""
        places = match.places_mm(pose)
        fixed = np.zeros((len(places), 3, FIXED))
        fixed[:, :, :6] = rigid_motion(places, modes.center_mm)
        self._match, self._pose = match, pose
        self._columns = np.concatenate([fixed, -modes.at(places, count)], axis=2)

    def expansion(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k, k) curvature and (k,) gradient of −log likelihood by a state of k unknowns."""
        columns = self._columns[:, :, : len(state)]
        gradient, curvature = self._match.similarity_expansion(self._pose, columns @ state)
        bent = np.einsum("bij,bjk->bik", curvature, columns)
        flat = columns.reshape(-1, columns.shape[2])
        return flat.T @ bent.reshape(flat.shape), flat.T @ gradient.ravel()


class NormalEquations(NamedTuple):
    """Equations of a step of a fit, the shared error integrated out.

    Attributes:
        curvature: (k, k); slope: (k,) of −log likelihood by the state.
        lower: (l, l) Cholesky factor of the shared error's curvature; mixed: (l, k), last: (l,) of it and the
            state, and of its slope, by that factor.
    """

    curvature: FloatArray
    slope: FloatArray
    lower: FloatArray
    mixed: FloatArray
    last: FloatArray

    def shared_change(self, change: FloatArray) -> FloatArray:
        """(l,) change of w that a change of the state leads to."""
        right = self.last + self.mixed @ change
        return np.asarray(solve_triangular(self.lower, right, trans=1, lower=True, check_finite=False))


class ShapeProblem:
    """Boundary points that lie near the model's boundary at a pose.

    Attributes:
        places_mm: (n, 3) the points at the pose, target frame; those that were touched come last.
        outward: (n, 3) unit normals of the model's boundary there, from the blood to the wall, or out of the
            organ.
        model_phase: (n,) when in the model's cycle each was seen.
        level: about which o and τ are counted.
        touched: (n,) True for points that were touched, which no image shows.
    """

    def __init__(
        self,
        seen: SeenBoundary,
        modes: ShapeModes,
        count: int,
        about: ShapePosterior | None = None,
        level: Level | None = None,
    ) -> None:
        """Place the points and evaluate the modes at them.

        Args:
            count: how many modes.
            about: change of shape at which points are compared with the model's edges; None: rigid.
            level: of another problem, whose o and τ these shall be; None: of these points.
        """
        boundary, offset_mm, pose = seen.boundary, seen.offset_mm, seen.pose
        few = boundary.points.subsampled(POINTS)
        oriented = BoundaryProblem(Boundary(few, boundary.target), modes.center_mm).points
        self._target = boundary.target
        places, phases = pose.apply_array(oriented.points), oriented.phases
        pulled = _pulled(places, modes, about)
        distance, gradient = self._target.distance(pulled, phases)
        length = np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-6)
        unit = gradient / length
        outward = boundary.target.polarity * unit
        normals = oriented.normals @ pose.rotation.T
        agreement = np.einsum("ni,ni->n", normals, outward)
        near = (np.abs(distance - offset_mm) < REACH_MM) & (agreement > 0.0)
        foot = -np.where(near, distance / length[:, 0], 0.0)[:, None] * unit
        edge = edges_of_model_mm(
            self._target.splines, pulled + foot, normals, few.planes @ pose.rotation.T, phases
        )
        near &= np.isfinite(edge)
        self.places_mm, self.outward = places[near], outward[near]
        self.model_phase, self._phases = few.model_phase[near], phases[near]
        depth = _depth_mm(seen.organ, few.model_phase, pulled + foot)[near]
        thin = np.exp(-np.maximum(depth, 0.0) / THIN_MM)
        mean = level.thin if level is not None else float(thin.mean()) if near.any() else 0.0
        thin -= mean
        self._offsets = agreement[near, None] * np.column_stack([np.ones(len(thin)), thin])
        at_edge = pulled + foot + np.nan_to_num(edge)[:, None] * normals
        self._edge_mm = self._target.distance(at_edge[near], self._phases)[0]
        middle_mm = float(np.median(self._edge_mm)) if near.any() else 0.0
        self.level = Level(offset_mm - middle_mm, mean) if level is None else level
        self._weight = oriented.weights[near] * agreement[near]
        self._motion = rigid_motion(self.places_mm, modes.center_mm)
        # modes at the feet of the points: at the points, a change that varies along the normal explains noise
        feet = (places + foot)[near]
        self._modes = modes.at(feet, count)
        self._left_out = _left_out(modes, feet, gradient[near], self._modes)
        self._shared = shared_error(oriented.points[near])
        self.touched = np.zeros(len(self.places_mm), dtype=np.bool_)
        self._organ: BoundaryTarget | None = None
        if seen.touched is not None and seen.organ is not None:
            self._touch(seen.touched, seen.organ, pose, modes, about)

    def _touch(
        self,
        touched: TouchedPoints,
        organ: BoundaryTarget,
        pose: Rigid,
        modes: ShapeModes,
        about: ShapePosterior | None,
    ) -> None:
        """Add points touched on the organ, which no image shows."""
        self._organ = organ
        places, phases = pose.apply(touched.points).xyz_mm, organ.nearest_phase(touched.model_phase)
        distance, gradient = organ.distance(_pulled(places, modes, about), phases)
        unit = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-6)
        near = (np.abs(distance) < REACH_MM) & (unit != 0.0).any(axis=1)
        places, phases, unit = places[near], phases[near], unit[near]
        count, feet = len(places), places - distance[near, None] * unit
        at_feet = modes.at(feet, self._modes.shape[2])
        added: dict[str, FloatArray | IntArray | BoolArray] = {
            "places_mm": places,
            "outward": -unit,
            "model_phase": touched.model_phase[near],
            "_phases": phases,
            "_offsets": np.zeros((count, 2)),
            "_edge_mm": np.zeros(count),
            "_weight": np.full(count, (NOISE_MM / touched.sigma_mm) ** 2),
            "_motion": rigid_motion(places, modes.center_mm),
            "_modes": at_feet,
            "_left_out": _left_out(modes, feet, gradient[near], at_feet),
            "touched": np.ones(count, dtype=np.bool_),
        }
        for name, of_points in added.items():
            setattr(self, name, np.concatenate([getattr(self, name), of_points]))
        self._shared = csr_array(vstack([self._shared, csr_array((count, self._shared.shape[1]))]))

    def __len__(self) -> int:
        return len(self.places_mm)

    def part(self, keep: BoolArray) -> "ShapeProblem":
        """Keep some of the points."""
        some = copy(self)
        for name, of_points in vars(self).items():
            if name not in ("_target", "_organ", "level"):
                setattr(some, name, of_points[keep])
        return some

    def _distances(self, places_mm: FloatArray, phases: IntArray) -> tuple[FloatArray, FloatArray]:
        """As `BoundaryTarget.distance`: of the boundary, and of the organ for points that were touched."""
        if self._organ is None:
            return self._target.distance(places_mm, phases)
        distance, gradient = np.empty(len(places_mm)), np.empty((len(places_mm), 3))
        for target, some in ((self._target, ~self.touched), (self._organ, self.touched)):
            distance[some], gradient[some] = target.distance(places_mm[some], phases[some])
        return distance, gradient

    def fit(
        self,
        scale_mm: float,
        noise: float,
        begin: ShapePosterior | None = None,
        steps: int = STEPS,
        images: ImagedBlocks | None = None,
        contraction: bool = False,
    ) -> ShapePosterior:
        """Fit at one scale of the change of shape; 0 keeps the heart rigid.

        Args:
            noise: factor on NOISE_MM and SHARED_MM.
            begin: fit to begin at.
            steps: most steps with OUTLIER_MM.
            images: whose LC2 counts as well, at steps with OUTLIER_MM; None: the boundary alone.
            contraction: whether the last of the state is how much further the heart contracts, as a share.
        """
        modes = self._modes if scale_mm > 0 else self._modes[:, :, :0]
        count, rows, variance = modes.shape[2], noise * self._shared, self._variance(scale_mm, noise)
        prior = np.full(FIXED + count + contraction, max(scale_mm, 1e-3) ** -2.0)
        prior[:FIXED] = [POSE_SIGMA_MM**-2] * 6 + [OFFSET_SIGMA_MM**-2, THIN_SIGMA_MM**-2]
        prior[FIXED + count :] = CONTRACTION_SIGMA**-2
        state, w = np.zeros(len(prior)), np.zeros(rows.shape[1])
        if begin is not None:
            kept = min(len(begin.state), FIXED + count)
            state[:kept] = begin.state[:kept]
        far = FAR if begin is None or begin.scale_mm == 0.0 else ()
        for step in range(len(far) + steps):
            outlier = OUTLIER_MM * (far[step] if step < len(far) else 1.0)
            at = self._normal_equations(state, w, modes, rows, variance, outlier)
            curvature, slope = at.curvature + np.diag(prior), at.slope + prior * state
            if images is not None and step >= len(far):
                more, gradient = images.expansion(state)
                curvature, slope = curvature + more, slope + gradient
            change = np.asarray(-np.linalg.solve(curvature, slope))
            state, w = state + change, w + at.shared_change(change)
            if np.linalg.norm(change[:6]) < SETTLED_MM and step >= len(far):
                break
        residual = self._expansion(state, modes)[0] - rows @ w
        near = 1.0 / (1.0 + (residual / OUTLIER_MM) ** 2)
        log_evidence = (
            -0.5 * float(self._weight @ (residual**2 / variance * near + np.log(variance)))
            - 0.5 * float(prior @ state**2 + w @ w - np.log(prior[FIXED:]).sum())
            - 0.5 * float(np.linalg.slogdet(curvature)[1])
            - float(np.log(np.diag(at.lower)).sum())
        )
        shared = float(np.mean(w**2))
        return ShapePosterior(state, np.linalg.inv(curvature), scale_mm, log_evidence, shared)

    def corrected(self, before: ShapePosterior, noise: float) -> ShapePosterior:
        """Correct a fit to earlier points, whose errors these do not share, by these.

        Args:
            noise: factor on NOISE_MM and SHARED_MM.
        """
        rows, variance = noise * self._shared, self._variance(before.scale_mm, noise)
        precision = np.linalg.inv(before.covariance_mm2)
        state, w = before.state, np.zeros(rows.shape[1])
        for _ in range(CORRECTION_STEPS):
            at = self._normal_equations(state, w, self._modes, rows, variance, OUTLIER_MM)
            curvature = at.curvature + precision
            change = np.asarray(-np.linalg.solve(curvature, at.slope + precision @ (state - before.state)))
            state, w = state + change, w + at.shared_change(change)
            if np.linalg.norm(change[:6]) < SETTLED_MM:
                break
        covariance = np.linalg.inv(curvature)
        return replace(before, state=state, covariance_mm2=0.5 * (covariance + covariance.T))

    def _variance(self, scale_mm: float, noise: float) -> FloatArray:
        """(n,) of the points' own errors, and of what the modes leave out."""
        return np.asarray((noise * NOISE_MM) ** 2 + scale_mm**2 * self._left_out)

    def _normal_equations(
        self,
        state: FloatArray,
        w: FloatArray,
        modes: FloatArray,
        rows: csr_array,
        variance: FloatArray,
        outlier_mm: float,
    ) -> "NormalEquations":
        """Expand −log likelihood, with w integrated out, about a state and a w."""
        residual, columns = self._expansion(state, modes)
        residual = residual - rows @ w
        root = np.sqrt(self._weight / variance) / (1.0 + (residual / outlier_mm) ** 2)
        expected, shared = root[:, None] * columns, rows.multiply(root[:, None]).tocsr()
        own = (shared.T @ shared).toarray() + np.eye(len(w))
        lower = cholesky(own, lower=True, overwrite_a=True, check_finite=False)
        right = np.column_stack([shared.T @ expected, shared.T @ (root * residual) - w])
        half = solve_triangular(lower, right, lower=True, overwrite_b=True, check_finite=False)
        mixed, last = half[:, :-1], half[:, -1]
        curvature = expected.T @ expected - mixed.T @ mixed
        return NormalEquations(curvature, expected.T @ (root * residual) - mixed.T @ last, lower, mixed, last)

    def shift_mm(self, fit: ShapePosterior) -> FloatArray:
        """(n,) pull-back along the normals that a fit gives at the points, also one to other points."""
        pulled = (
            self._modes[:, :, : len(fit.state) - FIXED] @ fit.state[FIXED:] - self._motion @ fit.state[:6]
        )
        return np.asarray(np.einsum("ni,ni->n", self.outward, pulled))

    def misfit(self, fit: ShapePosterior) -> float:
        """Mean of the points' robust squared residuals by a fit, also one to other points."""
        residual = self._expansion(fit.state, self._modes[:, :, : len(fit.state) - FIXED])[0]
        near = 1.0 / (1.0 + (residual / OUTLIER_MM) ** 2)
        return float(self._weight @ (residual**2 * near) / self._weight.sum())

    def _expansion(self, state: FloatArray, modes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) residual without the shared error, and (n, FIXED + k) its derivative by the state."""
        shape, contraction = np.split(state[FIXED:], [modes.shape[2]])
        pulled = self.places_mm + self._motion @ state[:6] - modes @ shape
        distance, gradient = self._distances(pulled, self._phases)
        moved = np.zeros((len(distance), len(contraction)))
        if len(contraction):
            at_rest, gradient_at_rest = self._distances(pulled, np.full_like(self._phases, self._target.rest))
            moved[:, 0] = distance - at_rest
            distance = distance + contraction[0] * moved[:, 0]
            gradient = gradient + contraction[0] * (gradient - gradient_at_rest)
        columns = [
            np.einsum("ni,nip->np", gradient, self._motion),
            -self._offsets,
            -np.einsum("ni,nik->nk", gradient, modes),
            moved,
        ]
        offset = self._offsets @ (state[6:FIXED] + np.array([self.level.offset_mm, 0.0]))
        residual = distance - self._edge_mm - offset
        return residual, np.concatenate(columns, axis=1)


def _pulled(places_mm: FloatArray, modes: ShapeModes, about: ShapePosterior | None) -> FloatArray:
    """(n, 3) places of the model that belong to places at a pose by a fit; None: the same."""
    if about is None:
        return places_mm
    moved = places_mm + rigid_motion(places_mm, modes.center_mm) @ about.state[:6]
    return moved - modes.displacement(places_mm, about.state[FIXED:])


def _left_out(
    modes: ShapeModes, feet_mm: FloatArray, gradient: FloatArray, of_modes: FloatArray
) -> FloatArray:
    """(n,) variance of a change of shape of 1 mm along gradients that the modes leave out."""
    inside = np.einsum("ni,nik->nk", gradient, of_modes)
    return np.asarray(np.maximum(modes.variance_along(feet_mm, gradient) - (inside**2).sum(axis=1), 0.0))


def _depth_mm(organ: BoundaryTarget | None, model_phase: FloatArray, places_mm: FloatArray) -> FloatArray:
    """(n,) depth of (n, 3) places within an organ at (n,) phases; infinite without one."""
    if organ is None:
        return np.full(len(places_mm), np.inf)
    distance, gradient = organ.distance(places_mm, organ.nearest_phase(model_phase))
    return np.asarray(distance / np.maximum(np.linalg.norm(gradient, axis=1), 0.5))


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
