"""Pose tracking between registrations: one measurement from each heart beat, fused by an information filter.

Each finished heart beat gives a handful of slices from nearly one view. Their LC2 is optimised from the pose
in use under a wide Gaussian prior (PRIOR_SIGMA_MM), which gives, in the coordinates of `PoseChart` about that
pose,

    ξ, J    optimum of the beat's slices, and its information              curvature of the cost
    ℓ       log-likelihood ratio of that optimum against the pose in use   −n/2·log(1 − S)

Monitoring: ℓ beyond what noise explains contradicts the pose. A beat that does not contradict it confirms it
only if it would have contradicted a wrong one; so the optimum is compared with poses WRONG_MM from it.
Tracking: an information filter,
    predict  P ← P + Q
    update   Λ = P⁻¹ + J,   ξ̂ = Λ⁻¹ (J ξ),   P ← Λ⁻¹,
so that directions which one beat cannot observe keep what earlier beats knew of them. P is how well the pose
is known against the beats to come. What all beats have in common (calibration, mismatch of the anatomy) no
beat reduces: the covariance S of the registration that the pose goes back to is kept as well as P, and P +
S is how well the pose is known against the truth (a consider covariance: Schmidt 1966). S holds the noise
that P begins with as well; of a heart that is covered in part, whose beats reduce little or none of it, S is
what it leaves of the covariance. A later registration is made of frames that the beats have used, with an
error of unknown correlation: it is fused by covariance intersection of P + S, which keeps both parts
(`split_intersection`).
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from dvf_ig.core import (
    HEART_RADIUS_MM,
    FloatArray,
    InvalidInputError,
    Rigid,
    Warp,
    mean_displacement_mm,
    read_only_arrays,
)
from dvf_ig.core.space.warp import RIGID_SIGMA_MM
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.optimise import PRIOR_SIGMA_MM, GaussianPrior, OptimiserOptions, optimise
from dvf_ig.registration.pose_chart import PoseChart, covariance_to_mm, rigid_motion
from dvf_ig.registration.shape.change import ShapeChange
from dvf_ig.registration.shape.estimate import PROCESS_NOISE_MM, ShapeEstimate

WEIGHT_TOLERANCE = 1e-3
"""Tolerance of ω: the determinant is flat at its minimum."""
FLAT = 1e-6
"""Logarithms of det P this near to each other count as the same."""
FIXED_FIT_STIFFNESS = 4.0
"""Curvature with the local fits fixed over what a beat's errors show: on tuning seeds 101–104 their χ² of 6
degrees has a median of 4.9 to 7.5. With the 8 to 12 of true curvature (see `lc2.optimise`) a still pose is
better, 0.87 against 0.92 mm, but its stated uncertainty is twice too large and a drift is followed too
slowly."""
WRONG_MM = 8.0
"""How far the wrong poses lie that a beat's optimum is compared with: a patient's shift worth finding."""
WRONG_DIRECTIONS = np.diag([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])[3:]
"""(3, 6) translations along the axes; more of them, or rotations, tell no more and cost 3 ms each."""
INFORMATIVE_LOG_RATIO = 1.5
"""Mean log-likelihood ratio of a beat's optimum against wrong poses, from which on it can confirm a pose. On
tuning seeds 101 to 103 good poses have 3.1 or more with poor images, 8 with few slices, 15 calm; black images
have 0, noise and speckle of any grain up to 0.44."""
TARGET_RADIUS_MM = 82.0
"""RMS distance of targets (landmarks; corners, edges, faces of the heart's box) from the box's centre: 82 to
83 mm in tuning hearts 101 to 104. A turn moves them by 2.05 times what it moves points at HEART_RADIUS_MM."""
MEAN_SQUARE_OF_COORDINATES = np.array([2 / 3 * (TARGET_RADIUS_MM / HEART_RADIUS_MM) ** 2] * 3 + [1.0] * 3)
"""Mean square distance over the targets for a unit of each coordinate."""
PLACES = np.linspace(-1.0, 1.0, 9)
"""Places across and down a plane, in half widths and depths, at which its change of shape is evaluated."""
THROUGHOUT = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 5)] * 3), axis=-1).reshape(-1, 3)
"""(n, 3) places throughout a heart, in its radius, at which its change of shape is evaluated."""
LEAST_VARIANCE_MM2 = 0.1
LARGEST = 1e12
"""Of any number of a beat, in s, mm and 1/mm²: larger ones are no measurement, and their squares overflow."""
BEAT_OPTIMISER = OptimiserOptions(steps=10, cap_mm=5.0, tolerance_mm=0.1)
"""Descents of a beat's slices, from the pose in use."""


def split_intersection(
    first_mm2: tuple[FloatArray, FloatArray], second_mm2: tuple[FloatArray, FloatArray], offset_mm: FloatArray
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Fuse two estimates of one quantity by covariance intersection, for errors of two independent parts.

    With T = P + S and C = (ω T₁⁻¹ + (1 − ω) T₂⁻¹)⁻¹, a part A becomes C (ω T₁⁻¹ A₁ T₁⁻¹ + (1 − ω) T₂⁻¹ A₂
    T₂⁻¹) C, no smaller than its true covariance for any correlation between the estimates; ω minimises det C.

    Args:
        first_mm2, second_mm2: (P, S), each (n, n); their sum is positive definite.
        offset_mm: (n,) second estimate minus the first.
    Returns:
        (n,) fused estimate minus the first, and its (P, S).

    Source: Julier and Uhlmann 1997.
    """
    first, second = np.linalg.inv(sum(first_mm2)), np.linalg.inv(sum(second_mm2))

    def log_determinant(weight: float) -> float:
        size = -float(np.linalg.slogdet(weight * first + (1.0 - weight) * second)[1])
        return size + FLAT * (weight - 0.5) ** 2

    inner = minimize_scalar(
        log_determinant, bounds=(0.0, 1.0), method="bounded", options={"xatol": WEIGHT_TOLERANCE}
    )
    weight = min((0.0, 1.0, float(inner.x)), key=log_determinant)
    covariance = np.linalg.inv(weight * first + (1.0 - weight) * second)
    gain, other_gain = covariance @ first, covariance @ second

    def fused(part: FloatArray, other: FloatArray) -> FloatArray:
        return np.asarray(weight * gain @ part @ gain.T + (1.0 - weight) * other_gain @ other @ other_gain.T)

    random, shared = map(fused, first_mm2, second_mm2)
    return (1.0 - weight) * (other_gain @ offset_mm), (random, shared)


def _noise_and_rest(covariance_mm2: FloatArray, noise_mm2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Divide (n, n) of all errors into what is noise of it in every direction, and the rest."""
    root = np.linalg.cholesky(covariance_mm2)
    share, directions = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, noise_mm2).T))
    directions, share = root @ directions, np.clip(share, 0.0, 1.0)
    return (directions * share) @ directions.T, (directions * (1.0 - share)) @ directions.T


def _nearest_rigid(places_mm: FloatArray, moved_mm: FloatArray, weights: FloatArray, frame: str) -> Rigid:
    """Fit the rigid motion that takes (n, 3) places nearest to where they go, by (n,) weights of sum 1.

    Source: Kabsch 1976.
    """
    middle, moved_middle = weights @ places_mm, weights @ moved_mm
    turn, _ = Rotation.align_vectors(moved_mm - moved_middle, places_mm - middle, weights=weights)
    rotation = turn.as_matrix()
    return Rigid(frame, frame, rotation, moved_middle - rotation @ middle)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """A pose and how well it is known.

    Covariances are (6, 6), in the coordinates of `PoseChart` about `center_mm`.

    Attributes:
        pose: target_from_source.
        covariance_mm2: P, against the beats to come.
        center_mm: (3,) centre of the heart box, target frame.
        shared_mm2: S, of the error that all beats have in common.
        shape_step: the pose is shape_step ∘ that at which images match best, which a change of the heart's
            shape has pulled aside (`registration.shape`); None if they are the same, or `warp` tells.
        shape: pose and change of the heart's shape together, which beats correct; None if the last
            registration found none.
        matching: the pose that beats move while a change of shape is followed: images match where `warp`
            takes it; None until a beat has moved it.
        square_of_targets: (6, 6) M, the mean square distance by which ξ moves the targets is ξᵀMξ.
    """

    pose: Rigid
    covariance_mm2: FloatArray
    center_mm: FloatArray
    shared_mm2: FloatArray
    shape_step: Rigid | None = None
    shape: ShapeEstimate | None = None
    matching: Rigid | None = None
    square_of_targets: FloatArray = field(default_factory=lambda: np.diag(MEAN_SQUARE_OF_COORDINATES))

    @classmethod
    def from_registration(
        cls,
        pose: Rigid,
        covariance: FloatArray,
        noise_covariance: FloatArray,
        center_mm: FloatArray,
        matched: Rigid | None = None,
        change: ShapeChange | None = None,
        targets_mm: FloatArray | None = None,
    ) -> "PoseEstimate":
        """From a registration's covariances in rad², mm²: beats improve the noise alone.

        Args:
            matched: where its images match best; None: at the pose.
            change: of the heart's shape at the pose, which fixtures follow.
            targets_mm: (n, 3) on the covered part of a heart, over which the error is stated, target frame;
                None: of the box of a heart that is covered as a whole.
        """
        shape = None if change is None else change.estimate
        step = None if matched is None or shape is not None else pose @ matched.inverse()
        noise, shared = covariance_to_mm(noise_covariance), covariance_to_mm(covariance)
        if targets_mm is not None:
            noise, shared = _noise_and_rest(shared, noise)
        estimate = cls(pose, noise, center_mm, shared, step, shape)
        if targets_mm is None:
            return estimate
        motion = rigid_motion(targets_mm, center_mm)
        square = np.einsum("nki,nkj->ij", motion, motion) / len(targets_mm)
        return replace(estimate, square_of_targets=square)

    @property
    def warp(self) -> Warp | None:
        """Change of the heart's shape at the pose; None if none is followed."""
        return None if self.shape is None else self.shape.warp

    @property
    def moved_by_beats(self) -> Rigid:
        """The pose that beats move: `matching` while a change of shape is followed, else `pose`."""
        return self.pose if self.matching is None else self.matching

    @property
    def matched_pose(self) -> Rigid:
        """Where images of a heart at this pose match best, all over the heart."""
        if self.warp is not None:
            throughout = HEART_RADIUS_MM * THROUGHOUT + self.center_mm
            return self._pulled(throughout, self.warp)[0] @ self.moved_by_beats
        return self.pose if self.shape_step is None else self.shape_step.inverse() @ self.pose

    def matched_in(self, view_mm: FloatArray) -> tuple[Rigid, float]:
        """Return where images of one plane match best, and how uncertain that is: a variance, mm².

        It is of each coordinate, beyond that of a heart that has kept its shape, which limits hold already.

        Those of a heart whose shape is followed lie aside by the rigid motion that is nearest to the change
        of shape in the plane, mostly where it is known well.

        Args:
            view_mm: (3, 3) two points half-way down the plane and one near its lower edge, source frame.
        """
        if self.warp is None:
            return self.matched_pose, 0.0
        left, right, low = view_mm
        middle = 0.5 * (left + right)
        across, down = np.meshgrid(PLACES, PLACES)
        places = middle + across.reshape(-1, 1) * (right - left) + down.reshape(-1, 1) * (low - middle)
        pulled, variance_mm2 = self._pulled(self.pose.apply_array(places), self.warp)
        return pulled @ self.moved_by_beats, max(0.0, variance_mm2 - RIGID_SIGMA_MM**2)

    def _pulled(self, places_mm: FloatArray, warp: Warp) -> tuple[Rigid, float]:
        """Return the rigid motion nearest to the change of shape at (n, 3) places, and its variance."""
        shift, variance = warp.at(places_mm)
        weights = np.maximum(variance, LEAST_VARIANCE_MM2) ** -2.0
        weights /= weights.sum()
        nearest = _nearest_rigid(places_mm, places_mm - shift, weights, self.pose.target)
        return nearest, float(weights @ variance)

    @property
    def total_mm2(self) -> FloatArray:
        """(6, 6) P + S: against the truth."""
        return self.covariance_mm2 + self.shared_mm2

    @property
    def pose_bound_mm(self) -> float:
        """95 % quantile of the RMS error over the targets, by `total_mm2`.

        A registration's `tre_bound_mm` is on the largest error over them instead. Of a heart whose shape is
        followed the pose alone says little: the error is that of the guarded walls along their normals, by
        those of `shape`, and by how far the heart may have moved since.

        Source: Satterthwaite 1946 (a quadratic form as a scaled χ² of the same mean and variance).
        """
        if self.shape is None:
            weighted, mean, square = self.square_of_targets @ self.total_mm2, 0.0, 0.0
        else:
            walls = self.shape.walls
            weighted = walls.square_of_motion @ self.covariance_mm2
            mean, square = walls.variance_mm2, walls.square_mm4
        mean, square = mean + float(np.trace(weighted)), square + float(np.sum(weighted * weighted.T))
        return math.sqrt(square / mean * float(chi2.ppf(0.95, mean * mean / square)))

    def predict(self, beats: float) -> "PoseEstimate":
        """Add the process noise of `beats` beats."""
        covariance = self.covariance_mm2 + beats * PROCESS_NOISE_MM**2 * np.eye(6)
        shape = None if self.shape is None else self.shape.predicted(beats)
        return replace(self, covariance_mm2=covariance, shape=shape)

    def update(
        self,
        offset_information_mm: FloatArray,
        information: FloatArray,
        shape: ShapeEstimate | None = None,
        *,
        certain: bool = True,
    ) -> "PoseEstimate":
        """The estimate with one more measurement.

        While a change of shape is followed the pose stays: what the heart moves by is a part of the change. A
        beat's own view, compared as a rigid heart's, would draw the walls aside from beat to beat
        (docs/decisions/0042). It moves the place where the next images should match, if it is certain where
        its own should.

        Args:
            offset_information_mm: (6,) Jξ, per mm, with ξ in the coordinates of `PoseChart` about
                `moved_by_beats`.
            information: (6, 6) J, per mm².
            shape: the change of shape, corrected by the same beat; None if its boundary says nothing of it.
            certain: the change of shape leaves the place where its images should match no less certain than
                a rigid heart does.
        """
        covariance = np.asarray(np.linalg.inv(np.linalg.inv(self.covariance_mm2) + information))
        moved = PoseChart(self.moved_by_beats, self.center_mm).pose(covariance @ offset_information_mm)
        if self.shape is None:
            return replace(self, pose=moved, covariance_mm2=covariance)
        matching = moved if certain else self.matching
        return replace(self, matching=matching, covariance_mm2=covariance, shape=shape or self.shape)

    def intersected_with(self, registered: "PoseEstimate", beats: float) -> "PoseEstimate":
        """With a registration of frames that the beats have used; see the module docstring.

        The registration says anew what the heart's shape pulls the images aside by, which differs from window
        to window of views by up to 2 mm: that far P no longer knows where a beat's images match.

        Args:
            beats: since the middle of its frames; the heart may have moved meanwhile.
        """
        chart = PoseChart(self.pose, self.center_mm)
        moved_mm2 = registered.predict(beats).covariance_mm2
        offset, (random, shared) = split_intersection(
            (self.covariance_mm2, self.shared_mm2),
            (moved_mm2, registered.shared_mm2),
            chart.coordinates(registered.pose),
        )
        pose, shape = chart.pose(offset), registered.shape
        if shape is not None:  # the walls are where the registration saw them
            shape = shape.predicted(beats).at_pose(registered.pose, pose)
            if self.shape is not None:
                shape = self.shape.at_pose(self.pose, pose).intersected_with(shape)
        there = replace(self, pose=pose, covariance_mm2=random, shared_mm2=shared, shape=shape, matching=None)
        rigid = self.shape is None and shape is None
        if rigid and registered.shape_step is self.shape_step:
            return there
        reshaped = replace(there, shape_step=registered.shape_step)
        before = there if rigid else self  # a change of shape says as well how far the heart has moved
        pulled = PoseChart(before.matched_pose, self.center_mm).coordinates(reshaped.matched_pose)
        return replace(reshaped, covariance_mm2=random + np.outer(pulled, pulled))

    def sigma_mm(self) -> float:
        """Standard deviation per coordinate by `total_mm2`, RMS over the six."""
        return float(np.sqrt(np.trace(self.total_mm2) / 6.0))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatMeasurement:
    """The slices of one beat, evaluated at a pose.

    Attributes:
        pose: at which they were evaluated; `best`: their optimum from there.
        offset_information_mm, information: (6,) Jξ and (6, 6) J in coordinates of `PoseChart` about `pose`; J
            is singular in directions that the slices do not observe.
        similarity: LC2 at `pose`; `best_similarity` at `best`.
        log_likelihood_ratio: of `best` against `pose`, >= 0.
        wrong_pose_log_ratio: of `best` against poses WRONG_MM from it, mean: what the beat would say of them.
        moved_mm: mean distance over the heart between `pose` and `best`.
        overlap: share of the slices inside the model's volume.
        evaluations: effort.
        variance_mm2: by which a change of shape leaves each coordinate of `pose` less certain than a rigid
            heart does.
    Raises:
        InvalidInputError: a number that is not finite, or beyond LARGEST; such a beat confirms nothing.
    """

    pose: Rigid
    best: Rigid
    offset_information_mm: FloatArray
    information: FloatArray
    similarity: float
    best_similarity: float
    log_likelihood_ratio: float
    wrong_pose_log_ratio: float
    moved_mm: float
    overlap: float
    evaluations: int
    variance_mm2: float = 0.0

    def __post_init__(self) -> None:
        told = (
            *(self.offset_information_mm, self.information, self.similarity, self.best_similarity),
            *(self.log_likelihood_ratio, self.wrong_pose_log_ratio, self.moved_mm, self.overlap),
        )
        if not all((np.abs(values) <= LARGEST).all() for values in told):
            raise InvalidInputError(
                f"a beat tells numbers that are not finite, or beyond {LARGEST:g}; it confirms nothing"
            )

    def of(self, estimate: PoseEstimate, variance_mm2: float) -> "BeatMeasurement":
        """A measurement where the images should match by an estimate, as one of the pose that beats move.

        Args:
            variance_mm2: by which each coordinate of that place is uncertain, see `PoseEstimate.matched_in`.
        """
        pose = estimate.moved_by_beats
        if self.pose is pose:
            return self
        there = replace(self, pose=pose, best=pose @ self.pose.inverse() @ self.best)
        return there if variance_mm2 == 0.0 else there._widened(variance_mm2)

    def _widened(self, variance_mm2: float) -> "BeatMeasurement":
        """The same with a further error of each coordinate, which explains a part of the likelihood ratio.

        The ratio is widened with the information that it has at its own distance: LC2 far from its optimum
        rises by less than its curvature there promises.
        """
        xi_mm = np.linalg.pinv(self.information, rcond=1e-9, hermitian=True) @ self.offset_information_mm
        promised = 0.5 * float(xi_mm @ self.offset_information_mm)
        share = min(1.0, self.log_likelihood_ratio / promised) if promised > 0.0 else 1.0
        information, of_ratio = (
            np.linalg.solve(np.eye(6) + variance_mm2 * known, known)
            for known in (self.information, share * self.information)
        )
        return replace(
            self,
            offset_information_mm=information @ xi_mm,
            information=0.5 * (information + information.T),
            variance_mm2=variance_mm2,
            log_likelihood_ratio=min(self.log_likelihood_ratio, 0.5 * float(xi_mm @ of_ratio @ xi_mm)),
        )

    @property
    def informative(self) -> bool:
        """Whether the beat says anything of the pose: black images, noise and mere speckle do not."""
        return self.wrong_pose_log_ratio >= INFORMATIVE_LOG_RATIO


def measure_beat(metric: Lc2, pose: Rigid, center_mm: FloatArray) -> BeatMeasurement:
    """Evaluate the slices of one beat at a pose.

    The prior is taken out of Jξ again: at the optimum its gradient balances that of the images.
    """
    chart = PoseChart(pose, center_mm)
    score = metric.score(pose)
    end = optimise(metric, pose, center_mm, GaussianPrior(chart), BEAT_OPTIMISER)
    equations = metric.normal_equations(end.pose, center_mm)
    there = equations.slope
    offset = chart.coordinates(end.pose)
    information = metric.information * equations.matrix / there.left / FIXED_FIT_STIFFNESS
    gain = math.log(max(1.0 - score.similarity, 1e-12) / max(1.0 - there.similarity, 1e-12))
    return BeatMeasurement(
        pose=pose,
        best=end.pose,
        offset_information_mm=information @ offset + offset / PRIOR_SIGMA_MM**2,
        information=information,
        similarity=score.similarity,
        best_similarity=there.similarity,
        log_likelihood_ratio=max(0.5 * metric.information * gain, 0.0),
        wrong_pose_log_ratio=_wrong_pose_log_ratio(metric, PoseChart(end.pose, center_mm), there.similarity),
        moved_mm=mean_displacement_mm(pose, end.pose, center_mm),
        overlap=score.overlap,
        evaluations=end.evaluations + 2 + len(WRONG_DIRECTIONS),
    )


def _wrong_pose_log_ratio(metric: Lc2, chart: PoseChart, similarity: float) -> float:
    """Mean log-likelihood ratio of a pose with this similarity against those WRONG_MM along every axis."""
    wrong = np.array([metric.score(chart.pose(WRONG_MM * xi)).similarity for xi in WRONG_DIRECTIONS])
    gains = np.log(np.maximum(1.0 - wrong, 1e-12) / max(1.0 - similarity, 1e-12))
    return float(0.5 * metric.information * gains.mean())
