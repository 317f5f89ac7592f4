"""Pose of the heart in breathing: ξ(t) = B s(t), learnt from the poses of single beats.

s = [1, ρ, L₀.₃ρ, L₀.₇ρ] follows the breath; its two lags stand for the hysteresis of the motion. The pose of
a beat is paired with the mean of s over its frames, since the heart moves while they are taken. It counts
from the pose that was taken for that of rest then, which registrations and beats move: each breath has a
constant of its own, so that only what changes within a breath is learnt.
Source: docs/theory/respiration.md.
"""

from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError, read_only_arrays

from .tracking.pose_estimate import MEAN_SQUARE_OF_COORDINATES

FEATURES = 4
CONSTANT_MM = 20.0
"""Prior SD of the constant part of ξ."""
MOTION_MM = np.array([1.0, 1.0, 1.0, 8.0, 8.0, 8.0])
"""Prior SD of the change of ξ with each other feature at unit SD, a third of a breath: hearts hardly turn by
more than 4°, or move by more than 23 mm, in one."""
REST_MM = 2.0
"""SD of each coordinate of the pose taken for that of rest, from breath to breath."""
LEAST_BEATS = 12
FOLDS = 4
"""Blocks of consecutive breaths, each held out once."""
BEYOND = 1.25
"""Mahalanobis radius, relative to the largest of what was learnt, beyond which a pose is no longer known."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BreathBeat:
    """One beat from which the pose in breathing is learnt.

    Attributes:
        features: (4,) mean of s over its frames; frames: (m, 4) of the single ones.
        information: (6, 6) J of its pose ξ in a `PoseChart`, 1/mm²; offset_information: (6,) J ξ.
        breath: number of the breath it belongs to.
    """

    features: FloatArray
    frames: FloatArray
    information: FloatArray
    offset_information: FloatArray
    breath: int


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BreathingPose:
    """Learnt pose in breathing.

    Attributes:
        b_mm: (4, 6) B, transposed.
        covariance: (4, 6, 4, 6) of it, mm².
        own_mm2: variance of each coordinate that the beats have beyond their noise: the model's own error.
        center: (4,), whitening: (4, 4): of the features it was learnt from.
        radius: largest whitened distance of a frame's features that counts as learnt.
        along: (6,) ξ of 1 mm of the heart's centre along the main direction of its motion, towards the top
            of a breath.
        held_out_mm: RMS over the heart of what held-out breaths missed, beyond their noise.
        breaths: number of breaths it was learnt from.
    """

    b_mm: FloatArray
    covariance: FloatArray
    own_mm2: float
    center: FloatArray
    whitening: FloatArray
    radius: float
    along: FloatArray
    held_out_mm: float
    breaths: int

    def xi_mm(self, features: FloatArray) -> FloatArray:
        """Compute (n, 6) ξ at (n, 4) features."""
        return np.asarray(features @ self.b_mm)

    def covariance_mm2(self, features: FloatArray) -> FloatArray:
        """Compute (n, 6, 6) covariance of ξ: of the parameters, and of the model's own error."""
        of_parameters = np.einsum("ni,ikjl,nj->nkl", features, self.covariance, features)
        return np.asarray(of_parameters + self.own_mm2 * np.eye(6))

    def knows(self, features: FloatArray) -> BoolArray:
        """Return whether each of (n, 4) features lies in the ellipsoid of what was learnt; False for NaN."""
        apart = (features - self.center) @ self.whitening
        return np.asarray(np.linalg.norm(apart, axis=1) <= self.radius)

    def displacement_mm(self, features: FloatArray) -> FloatArray:
        """Compute how far (n, 4) features move the heart's centre along the main direction of its motion."""
        return np.asarray(self.xi_mm(features) @ self.along)

    def residuals_mm(self, beats: "tuple[BreathBeat, ...]") -> tuple[FloatArray, FloatArray]:
        """Compute what (n,) beats miss along the main direction, and its standard deviation.

        The constant of each breath is taken out. The deviation holds the noise of the beat, whose views do
        not see all directions alike, and the model's own error.
        """
        table = _Table.of(beats)
        covariance = np.linalg.inv(table.information + np.eye(6) / CONSTANT_MM**2)
        square_mm2 = np.einsum("i,nij,j->n", self.along, covariance, self.along) + self.own_mm2
        return table.apart_mm(self.b_mm) @ self.along, np.sqrt(square_mm2)


def learn_breathing(beats: tuple[BreathBeat, ...]) -> BreathingPose | None:
    """Learn B by Bayesian ridge; None from fewer than LEAST_BEATS beats or three breaths.

    Raises:
        InvalidInputError: a beat that is not finite.
    """
    if any(not np.isfinite(beat.features).all() or not np.isfinite(beat.information).all() for beat in beats):
        raise InvalidInputError("a beat's features or pose are not finite; leave the beat out")
    table = _Table.of(beats)
    breaths = np.unique(table.breaths)
    if len(beats) < LEAST_BEATS or len(breaths) < 3:
        return None
    own = 0.0
    for _ in range(3):  # the model's own error widens every beat, which changes the fit a little
        b_mm, covariance = _ridge(table, own)
        own = _own_variance(table, b_mm)
    frames = np.concatenate([beat.frames for beat in beats])
    center = frames.mean(axis=0)
    spread = np.cov((frames - center)[:, 1:].T)
    whitening = np.zeros((FEATURES, FEATURES))
    whitening[1:, 1:] = np.linalg.cholesky(np.linalg.inv(spread + 1e-4 * np.eye(FEATURES - 1)))
    reach = np.linalg.norm((frames - center) @ whitening, axis=1)
    radius = BEYOND * float(np.quantile(reach, 0.995))
    along, held_out_mm = _main_direction(b_mm, spread), _held_out_mm(table, breaths, own)
    return BreathingPose(b_mm, covariance, own, center, whitening, radius, along, held_out_mm, len(breaths))


def misfits(beats: tuple[BreathBeat, ...], features: FloatArray) -> FloatArray:
    """Compute what fits to other features of the beats miss, as multiples of what a good fit would.

    Args:
        features: (m, n, 4) m alternatives for n beats; NaN for a beat that one of them does not have.
    Returns:
        (m,) χ² over its expected value, times the degrees of freedom.
    """
    finite = np.asarray(np.isfinite(features).all(axis=(0, 2)))
    table = _Table.of(tuple(beat for beat, here in zip(beats, finite, strict=True) if here))
    tables = [replace(table, features=one[finite]) for one in features]
    missed = np.array([one.missed(_ridge(one, 0.0)[0]) for one in tables])
    return np.asarray(missed / max(1.0, float(missed.min()) / max(tables[0].fitted_freedom, 1.0)))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Beats as arrays over n of them.

    Attributes:
        features: (n, 4); information: (n, 6, 6); offsets: (n, 6) J ξ; xi_mm: (n, 6).
        seen: (n,) directions that a beat tells anything of.
        breaths: (n,)
    """

    features: FloatArray
    information: FloatArray
    offsets: FloatArray
    xi_mm: FloatArray
    seen: FloatArray
    breaths: IntArray

    @classmethod
    def of(cls, beats: tuple[BreathBeat, ...]) -> "_Table":
        information = np.array([beat.information for beat in beats]).reshape(-1, 6, 6)
        offsets = np.array([beat.offset_information for beat in beats]).reshape(-1, 6)
        inverses = np.linalg.pinv(information, rcond=1e-9, hermitian=True)
        shares = np.linalg.solve(information + np.eye(6) / CONSTANT_MM**2, information)
        return cls(
            np.array([beat.features for beat in beats]).reshape(-1, FEATURES),
            information,
            offsets,
            np.einsum("nij,nj->ni", inverses, offsets),
            np.trace(shares, axis1=1, axis2=2),
            np.array([beat.breath for beat in beats]),
        )

    def part(self, chosen: BoolArray) -> "_Table":
        """Choose beats."""
        return _Table(*(getattr(self, name)[chosen] for name in self.__slots__))

    @property
    def first(self) -> BoolArray:
        """(n,) beats that are the first of their breath."""
        return np.append(True, self.breaths[1:] != self.breaths[:-1])

    def by_breath(self, values: FloatArray) -> FloatArray:
        """Sum (n, …) values over the beats of each breath, which follow one another."""
        return np.asarray(np.add.reduceat(values, np.flatnonzero(self.first), axis=0))

    def rests(self, information: FloatArray) -> FloatArray:
        """Compute the (breaths, 6, 6) covariance of the constant of each breath, given B."""
        return np.asarray(np.linalg.inv(self.by_breath(information) + np.eye(6) / REST_MM**2))

    @property
    def freedom(self) -> float:
        """Directions that the beats tell beyond the constants of their breaths: the expected χ² of noise."""
        constants = np.einsum("bij,bji->", self.rests(self.information), self.by_breath(self.information))
        return float(self.seen.sum() - constants)

    @property
    def fitted_freedom(self) -> float:
        """Expected χ² of noise of beats from which B was learnt, which takes the share of its lags and ρ."""
        return self.freedom - float(self.seen.sum()) * (FEATURES - 1) / len(self.features)

    @property
    def trace(self) -> float:
        """Expected χ² of a variance of 1 mm² of each coordinate of each beat."""
        square = self.by_breath(self.information @ self.information)
        whole = np.einsum("nii->", self.information)
        return float(whole - np.einsum("bij,bji->", self.rests(self.information), square))

    def apart_mm(self, b_mm: FloatArray) -> FloatArray:
        """Compute (n, 6) ξ less that of B and of the constant that suits its breath best."""
        apart = self.xi_mm - self.features @ b_mm
        pulls = self.by_breath(np.einsum("nij,nj->ni", self.information, apart))
        constants = np.einsum("bij,bj->bi", self.rests(self.information), pulls)
        return np.asarray(apart - constants[np.cumsum(self.first) - 1])

    def missed(self, b_mm: FloatArray) -> float:
        """Sum the squared residuals over their noise, and those of the constants of breaths."""
        apart = self.apart_mm(b_mm)
        whole = self.xi_mm - self.features @ b_mm
        return float(np.einsum("ni,nij,nj->", whole, self.information, apart, optimize=True))


def _main_direction(b_mm: FloatArray, spread: FloatArray) -> FloatArray:
    """Find (6,) `BreathingPose.along` by B and the (3, 3) covariance of ρ and its lags."""
    shifts = b_mm[1:, 3:]
    _, axes = np.linalg.eigh(shifts.T @ spread @ shifts)
    top = 1.0 if shifts.sum(axis=0) @ axes[:, -1] >= 0.0 else -1.0
    return np.concatenate([np.zeros(3), top * axes[:, -1]])


def normal_matrix(features: FloatArray, information: FloatArray) -> FloatArray:
    """(6 p, 6 p) normal equations of ξ = Bᵀ f by (n, p) features and (n, 6, 6) information."""
    beats, count = features.shape
    products = (features[:, :, None] * features[:, None, :]).reshape(beats, -1)
    normal = (products.T @ information.reshape(beats, 36)).reshape(count, count, 6, 6)
    return np.asarray(normal.transpose(0, 2, 1, 3).reshape(6 * count, 6 * count))


def _ridge(beats: _Table, own_mm2: float) -> tuple[FloatArray, FloatArray]:
    """Solve for B (4, 6) and its covariance (4, 6, 4, 6); ξ of a beat varies by `own_mm2` beyond noise."""
    features = beats.features
    scale = np.concatenate([[1.0], np.maximum(features[:, 1:].std(axis=0), 1e-6)])
    scaled = features / scale
    widened = np.linalg.inv(np.eye(6) + own_mm2 * beats.information)
    information = widened @ beats.information
    information = 0.5 * (information + information.transpose(0, 2, 1))
    offsets = np.einsum("nij,nj->ni", widened, beats.offsets)
    shared = beats.by_breath(np.einsum("ni,nkl->nikl", scaled, information)).reshape(-1, 6 * FEATURES, 6)
    absorbed = shared @ beats.rests(information)
    right = (scaled.T @ offsets).ravel() - np.einsum("bij,bj->i", absorbed, beats.by_breath(offsets))
    prior = np.vstack([np.full(6, CONSTANT_MM), np.tile(MOTION_MM, (FEATURES - 1, 1))])
    matrix = normal_matrix(scaled, information) + np.diag(prior.ravel() ** -2.0)
    matrix -= np.einsum("bij,bkj->ik", absorbed, shared)
    covariance = np.linalg.inv(matrix).reshape(FEATURES, 6, FEATURES, 6)
    b_mm = np.einsum("ikjl,jl->ik", covariance, right.reshape(FEATURES, 6))
    covariance = covariance / scale[:, None, None, None] / scale[None, None, :, None]
    return b_mm / scale[:, None], covariance


def _own_variance(beats: _Table, b_mm: FloatArray) -> float:
    """Estimate the variance of a coordinate beyond the noise."""
    return max(0.0, (beats.missed(b_mm) - beats.fitted_freedom) / beats.trace)


def _held_out_mm(beats: _Table, breaths: IntArray, own_mm2: float) -> float:
    """Learn without each block of breaths in turn, and measure what it misses of them beyond the noise."""
    beyond = 0.0
    for block in np.array_split(breaths, min(FOLDS, len(breaths))):
        out = np.isin(beats.breaths, block)
        b_mm, _ = _ridge(beats.part(~out), own_mm2)
        beyond += beats.part(out).missed(b_mm) - beats.part(out).freedom
    mean_mm2 = max(0.0, beyond / beats.trace)
    return float(np.sqrt(mean_mm2 * MEAN_SQUARE_OF_COORDINATES.sum()))
