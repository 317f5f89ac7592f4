"""Pose of the heart in breathing: ξ(t) = B s(t), learnt from the poses of single beats.

s = [1, ρ, L₀.₃ρ, L₀.₇ρ] follows the breath; its two lags stand for the hysteresis of the motion. The pose of
a beat is paired with the mean of s over its frames, since the heart moves while they are taken.
Source: docs/theory/respiration.md.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, read_only_arrays

FEATURES = 4
CONSTANT_MM = 50.0
"""Prior SD of the constant part of ξ, and of its change with each other feature at unit SD."""
MOTION_MM = 8.0
LEAST_BEATS = 12
FOLDS = 4
"""Blocks of consecutive breaths, each held out once."""
BEYOND = 1.25
"""Mahalanobis radius, relative to the largest of what was learnt, beyond which a pose is no longer known."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatPoses:
    """Beats from which the pose in breathing is learnt.

    Attributes:
        features: (n, 4) mean of s over each beat's frames.
        xi_mm: (n, 6) pose of each in a `PoseChart`.
        noise_mm: (n,) SD of its coordinates.
        breath: (n,) number of the breath it belongs to.
    """

    features: FloatArray
    xi_mm: FloatArray
    noise_mm: FloatArray
    breath: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BreathingPose:
    """Learnt pose in breathing.

    Attributes:
        b_mm: (4, 6) B, transposed.
        covariance: (4, 4) of every column of B, mm².
        own_mm2: (6,) variance that the beats' poses have beyond their noise: the model's own error.
        center: (4,), whitening: (4, 4): of the features it was learnt from.
        radius: largest whitened distance of a frame's features that counts as learnt.
        held_out_mm: RMS over the heart of what held-out breaths missed, beyond their noise.
        breaths: number of breaths it was learnt from.
    """

    b_mm: FloatArray
    covariance: FloatArray
    own_mm2: FloatArray
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
        of_parameters = np.einsum("ni,ij,nj->n", features, self.covariance, features)
        return np.asarray(of_parameters[:, None, None] * np.eye(6) + np.diag(self.own_mm2))

    def knows(self, features: FloatArray) -> BoolArray:
        """Return whether each of (n, 4) features lies in the ellipsoid of what was learnt; False for NaN."""
        apart = (features - self.center) @ self.whitening
        return np.asarray(np.linalg.norm(apart, axis=1) <= self.radius)


def learn_breathing(beats: BeatPoses, frames: FloatArray) -> BreathingPose | None:
    """Learn B by Bayesian ridge; None from fewer than LEAST_BEATS beats or three breaths.

    Args:
        frames: (m, 4) features of the single frames, which span what was learnt.
    Raises:
        InvalidInputError: rows that do not match, or not finite.
    """
    n = len(beats.features)
    if beats.features.shape != (n, FEATURES) or beats.xi_mm.shape != (n, 6):
        raise InvalidInputError(
            f"beats have {beats.features.shape} features, {beats.xi_mm.shape} poses; needed (n, 4), (n, 6)"
        )
    if not (np.isfinite(beats.features).all() and np.isfinite(beats.xi_mm).all()):
        raise InvalidInputError("a beat's features or pose are not finite; leave the beat out")
    breaths = np.unique(beats.breath)
    if n < LEAST_BEATS or len(breaths) < 3:
        return None
    b_mm, covariance = _ridge(beats, np.ones(n, dtype=np.bool_))
    missed = beats.xi_mm - beats.features @ b_mm
    own = _own_variance(missed, beats.noise_mm, FEATURES / n)
    covariance = covariance * max(
        1.0, float(((missed / beats.noise_mm[:, None]) ** 2).mean() * n / (n - FEATURES))
    )
    center = frames.mean(axis=0)
    spread = np.cov((frames - center)[:, 1:].T)
    root = np.linalg.cholesky(np.linalg.inv(spread + 1e-4 * np.eye(FEATURES - 1)))
    whitening = np.zeros((FEATURES, FEATURES))
    whitening[1:, 1:] = root
    reach = np.linalg.norm((frames - center) @ whitening, axis=1)
    return BreathingPose(
        b_mm,
        covariance,
        own,
        center,
        whitening,
        BEYOND * float(np.quantile(reach, 0.995)),
        _held_out_mm(beats, breaths),
        len(breaths),
    )


def _ridge(beats: BeatPoses, used: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Solve for B (4, 6) and the covariance (4, 4) of its columns from the beats used."""
    features, noise = beats.features, beats.noise_mm
    scale = np.concatenate([[1.0], np.maximum(features[:, 1:].std(axis=0), 1e-6)])
    x = features[used] / scale / noise[used][:, None]
    prior = np.concatenate([[CONSTANT_MM], np.full(FEATURES - 1, MOTION_MM)])
    covariance = np.linalg.inv(x.T @ x + np.diag(prior**-2.0))
    b_mm = covariance @ (x.T @ (beats.xi_mm[used] / noise[used][:, None]))
    return b_mm / scale[:, None], covariance / np.outer(scale, scale)


def _own_variance(missed: FloatArray, noise_mm: FloatArray, fitted: float) -> FloatArray:
    """Estimate (6,) variance of (n, 6) residuals beyond the noise, of which the fit absorbed a share."""
    excess = (missed**2).mean(axis=0) - float((noise_mm**2).mean()) * (1.0 - fitted)
    return np.full(6, max(0.0, float(excess.mean())))


def _held_out_mm(beats: BeatPoses, breaths: FloatArray) -> float:
    """Learn without each block of breaths in turn, and measure what it misses of them beyond the noise."""
    total, count = 0.0, 0
    for block in np.array_split(breaths, min(FOLDS, len(breaths))):
        out = np.isin(beats.breath, block)
        b_mm, _ = _ridge(beats, ~out)
        missed = beats.xi_mm[out] - beats.features[out] @ b_mm
        total += float((missed**2).sum() - 6.0 * (beats.noise_mm[out] ** 2).sum())
        count += int(out.sum())
    # over the heart a unit of each of the three turns moves by two thirds of its square
    return float(np.sqrt(max(0.0, total / count / 6.0) * (3.0 + 2.0)))
