"""Pose of the heart in breathing: ξ(t) = B s(t), learnt from the poses of single beats.

s = [1, ρ, L₀.₃ρ, L₀.₇ρ] follows the breath; its two lags stand for the hysteresis of the motion. The pose of
a beat is paired with the mean of s over its frames, since the heart moves while they are taken.
Source: docs/theory/respiration.md.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, read_only_arrays

from .tracking.pose_estimate import MEAN_SQUARE_OF_COORDINATES

FEATURES = 4
CONSTANT_MM = 20.0
"""Prior SD of the constant part of ξ, and of its change with each other feature at unit SD."""
MOTION_MM = 8.0
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
        held_out_mm: RMS over the heart of what held-out breaths missed, beyond their noise.
        breaths: number of breaths it was learnt from.
    """

    b_mm: FloatArray
    covariance: FloatArray
    own_mm2: float
    center: FloatArray
    whitening: FloatArray
    radius: float
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


def learn_breathing(beats: tuple[BreathBeat, ...]) -> BreathingPose | None:
    """Learn B by Bayesian ridge; None from fewer than LEAST_BEATS beats or three breaths.

    Raises:
        InvalidInputError: a beat that is not finite.
    """
    if any(not np.isfinite(beat.features).all() or not np.isfinite(beat.information).all() for beat in beats):
        raise InvalidInputError("a beat's features or pose are not finite; leave the beat out")
    breaths = sorted({beat.breath for beat in beats})
    if len(beats) < LEAST_BEATS or len(breaths) < 3:
        return None
    own = 0.0
    for _ in range(3):  # the model's own error widens every beat, which changes the fit a little
        b_mm, covariance = _ridge(beats, own)
        own = _own_variance(beats, b_mm)
    frames = np.concatenate([beat.frames for beat in beats])
    center = frames.mean(axis=0)
    spread = np.cov((frames - center)[:, 1:].T)
    whitening = np.zeros((FEATURES, FEATURES))
    whitening[1:, 1:] = np.linalg.cholesky(np.linalg.inv(spread + 1e-4 * np.eye(FEATURES - 1)))
    reach = np.linalg.norm((frames - center) @ whitening, axis=1)
    radius = BEYOND * float(np.quantile(reach, 0.995))
    return BreathingPose(
        b_mm, covariance, own, center, whitening, radius, _held_out_mm(beats, breaths, own), len(breaths)
    )


def _ridge(beats: tuple[BreathBeat, ...], own_mm2: float) -> tuple[FloatArray, FloatArray]:
    """Solve for B (4, 6) and its covariance (4, 6, 4, 6); ξ of a beat varies by `own_mm2` beyond noise."""
    features = np.array([beat.features for beat in beats])
    scale = np.concatenate([[1.0], np.maximum(features[:, 1:].std(axis=0), 1e-6)])
    normal, right = np.zeros((FEATURES, 6, FEATURES, 6)), np.zeros((FEATURES, 6))
    for beat in beats:
        widened = np.linalg.inv(np.eye(6) + own_mm2 * beat.information)
        f, j, h = beat.features / scale, widened @ beat.information, widened @ beat.offset_information
        normal += np.einsum("i,j,kl->ikjl", f, f, 0.5 * (j + j.T))
        right += np.outer(f, h)
    prior = np.concatenate([[CONSTANT_MM], np.full(FEATURES - 1, MOTION_MM)])
    size = FEATURES * 6
    matrix = normal.reshape(size, size) + np.diag(np.repeat(prior**-2.0, 6))
    covariance = np.linalg.inv(matrix).reshape(FEATURES, 6, FEATURES, 6)
    b_mm = np.einsum("ikjl,jl->ik", covariance, right)
    covariance = covariance / scale[:, None, None, None] / scale[None, None, :, None]
    return b_mm / scale[:, None], covariance


def _own_variance(beats: tuple[BreathBeat, ...], b_mm: FloatArray) -> float:
    """Estimate the variance of a coordinate beyond the noise, of which the fit absorbs a share."""
    missed, widths, seen = _missed(beats, b_mm)
    return max(0.0, (missed - seen * (1.0 - FEATURES / len(beats))) / widths)


def _missed(beats: tuple[BreathBeat, ...], b_mm: FloatArray) -> tuple[float, float, float]:
    """Sum squared residuals over their noise, the traces of the information, and the directions seen."""
    square, trace, seen = 0.0, 0.0, 0.0
    for beat in beats:
        xi = np.linalg.lstsq(beat.information, beat.offset_information, rcond=1e-9)[0]
        apart = xi - beat.features @ b_mm
        square += float(apart @ beat.information @ apart)
        trace += float(np.trace(beat.information))
        total = beat.information + np.eye(6) / CONSTANT_MM**2
        seen += float(np.trace(np.linalg.solve(total, beat.information)))
    return square, trace, seen


def _held_out_mm(beats: tuple[BreathBeat, ...], breaths: list[int], own_mm2: float) -> float:
    """Learn without each block of breaths in turn, and measure what it misses of them beyond the noise."""
    square, trace, seen = 0.0, 0.0, 0.0
    for block in np.array_split(np.array(breaths), min(FOLDS, len(breaths))):
        out = tuple(beat for beat in beats if beat.breath in block)
        b_mm, _ = _ridge(tuple(beat for beat in beats if beat.breath not in block), own_mm2)
        of_block = _missed(out, b_mm)
        square, trace, seen = square + of_block[0], trace + of_block[1], seen + of_block[2]
    return float(np.sqrt(max(0.0, (square - seen) / trace) * MEAN_SQUARE_OF_COORDINATES.sum()))
