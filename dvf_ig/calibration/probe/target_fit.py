"""Image map and target together by least squares on the frames that agree."""

from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from scipy.stats import chi2

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    ImageMap,
    InvalidInputError,
    PoseStream,
    QualityGateError,
    read_only_arrays,
)

from .covariance import MapUncertainty, piece_jackknife, refuse_unconstrained
from .map_parameters import MapParameters
from .target_views import TargetErrors, Views, rejections, target_errors


class Target(Protocol):
    """Something fixed in the poses' target frame, moved by three numbers."""

    def misses_mm(self, placed_mm: FloatArray) -> FloatArray:
        """(f, r) residuals of placed points (f, k, 3)."""

    def slope(self, placed_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(f, r, k, 3) derivative by the placed points, and (f, r, 3) by the target's own step."""

    def stepped(self, step: FloatArray) -> Self:
        """The target a (3,) step away."""


T = TypeVar("T", bound=Target)


@dataclass(frozen=True, slots=True)
class TargetOptions:
    """How frames are chosen and what is refused.

    Attributes:
        isotropic: one pixel size instead of two.
        hypotheses: random subsets of frames tried before the fit.
        subset: frames a subset.
        keep_sigma: frames that miss by at most this many robust sigmas take part.
        min_frames: fewest frames accepted.
        max_rms_mm: largest accepted RMS miss of the frames that take part.
        max_position_sd_mm, max_rotation_sd_deg, max_scale_sd_percent: largest accepted standard deviations,
            of the middle of the region where the target was seen.
        least_noise_mm: noise by which the motion is judged where residuals are smaller.
    """

    isotropic: bool = False
    hypotheses: int = 60
    subset: int = 12
    keep_sigma: float = 5.0
    min_frames: int = 15
    max_rms_mm: float = 3.0
    max_position_sd_mm: float = 1.0
    max_rotation_sd_deg: float = 2.0
    max_scale_sd_percent: float = 5.0
    least_noise_mm: float = 0.1

    def __post_init__(self) -> None:
        if self.hypotheses < 1:
            raise InvalidInputError(f"{self.hypotheses} subsets of frames are tried; needed at least 1")


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ProbeTargetResult(Generic[T]):
    """An image calibration from a fixed target, with its evidence.

    Attributes:
        probe_from_image: rotation, translation and pixel size.
        target: where the point or plane lies, in the poses' target frame.
        calibration: errors over every usable frame of the recording, outliers included.
        held_out: errors of the frames that took part, each under the calibration made without it.
        uncertainty: 95 % intervals.
        inliers: (n,) frames of the recording that took part.
        rejected: (frame, reason) of all others.
    """

    probe_from_image: ImageMap
    target: T
    calibration: TargetErrors
    held_out: TargetErrors
    uncertainty: MapUncertainty
    inliers: BoolArray
    rejected: tuple[tuple[int, str], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Fit(Generic[T]):
    """One state of the search: parameters about the current map, target, and cost of its frames."""

    parameters: MapParameters
    target: T
    cost: float


def joint_jacobian(parameters: MapParameters, target: T, views: Views) -> FloatArray:
    """(f, r, count + 3) derivative of the misses by the map's parameters, then by the target's."""
    rotations = views.rotations @ parameters.estimate.rigid.rotation
    placed = np.einsum("fij,fkjp->fkip", rotations, parameters.jacobian(views.pixels))
    by_point, by_target = target.slope(views.placed_mm(parameters.estimate))
    return np.concatenate([np.einsum("frki,fkip->frp", by_point, placed), by_target], axis=2)


def settle(start: Fit[T], views: Views, steps: int = 60) -> Fit[T]:
    """Damped Gauss-Newton, linearised anew about every accepted state."""
    state, damping = start, 1e-4
    miss = state.target.misses_mm(views.placed_mm(state.parameters.estimate))
    cost = float((miss**2).sum())
    for _ in range(steps):
        jacobian = joint_jacobian(state.parameters, state.target, views).reshape(miss.size, -1)
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ miss.ravel()
        fall = 0.0
        for _ in range(8):
            curbed = normal + np.diag(damping * np.diag(normal) + 1e-12 * np.trace(normal))
            step = -np.asarray(np.linalg.solve(curbed, gradient), dtype=np.float64)
            trial = _stepped(state, step)
            new_miss = trial.target.misses_mm(views.placed_mm(trial.parameters.estimate))
            fall = cost - float((new_miss**2).sum())
            if fall >= 0:
                damping = max(damping / 10, 1e-12)
                break
            damping *= 10
        if fall < 0:
            break
        state, miss, cost = trial, new_miss, cost - fall
        if fall <= 1e-13 * cost + 1e-20:
            break
    return Fit(state.parameters, state.target, cost)


def frame_misses_mm(fit: Fit[T], views: Views) -> FloatArray:
    """(f,) length of each frame's residual."""
    misses = fit.target.misses_mm(views.placed_mm(fit.parameters.estimate))
    return np.asarray(np.linalg.norm(misses, axis=1))


def concentrate(start: Fit[T], views: Views, keep: BoolArray, rounds: int = 12) -> Fit[T]:
    """Fit to the better half of the frames again and again, until the half stands still.

    Source: Rousseeuw & Van Driessen 2006 (C-steps of least trimmed squares).
    Returns:
        The fit; its cost is that of the better half.
    """
    half = max(len(views) // 2 + 1, min(len(views), 12))
    fit = start
    for _ in range(rounds):
        fit = settle(fit, views.part(keep), 15)
        order = np.argsort(frame_misses_mm(fit, views), kind="stable")
        again = np.zeros(len(views), dtype=np.bool_)
        again[order[:half]] = True
        if np.array_equal(again, keep):
            break
        keep = again
    misses = np.sort(frame_misses_mm(fit, views))[:half]
    return Fit(fit.parameters, fit.target, float((misses**2).sum()))


def agreeing(fit: Fit[T], views: Views, options: TargetOptions) -> tuple[Fit[T], BoolArray, float]:
    """Fit on all frames within `keep_sigma`, which frames those are, and the largest miss kept."""
    keep, limit = np.ones(len(views), dtype=np.bool_), np.inf
    for round_ in range(30):
        misses = frame_misses_mm(fit, views)
        unknowns = fit.target.misses_mm(views.placed_mm(fit.parameters.estimate)).shape[1]
        sigma = float(np.median(misses)) / float(np.sqrt(chi2.ppf(0.5, unknowns)))
        limit = max(options.keep_sigma * sigma, 1e-6)
        again = misses <= limit
        if round_ and np.array_equal(again, keep):
            break
        keep = again
        fit = settle(fit, views.part(keep))
    return fit, keep, limit


def finished(
    fit: Fit[T],
    poses: PoseStream,
    points_px: FloatArray,
    views: Views,
    keep: BoolArray,
    limit_mm: float,
    options: TargetOptions,
    advice: dict[str, str],
) -> ProbeTargetResult[T]:
    """The result of a settled fit on the frames `keep`, or the reason why there is none.

    Raises:
        QualityGateError: too few frames agree, the misses are large, or the motion leaves a parameter open.
    """
    needed = max(options.min_frames, len(keep) // 2)
    if keep.sum() < needed:
        raise QualityGateError(
            f"only {int(keep.sum())} of {len(keep)} frames agree on one calibration, needed {needed}; check "
            "that the target stood still and that the points belong to these frames"
        )
    uncertainty = _judged(fit, views.part(keep), options, advice)
    misses = frame_misses_mm(fit, views)
    share = np.sqrt(views.pixels.shape[1])
    inliers = np.zeros(len(poses), dtype=np.bool_)
    inliers[views.frames[keep]] = True
    return ProbeTargetResult(
        probe_from_image=fit.parameters.estimate,
        target=fit.target,
        calibration=target_errors(misses / share, len(poses)),
        held_out=target_errors(uncertainty.held_out_mm / share, len(poses)),
        uncertainty=uncertainty,
        inliers=inliers,
        rejected=rejections(poses, points_px, views, misses, limit_mm),
    )


def _judged(fit: Fit[T], views: Views, options: TargetOptions, advice: dict[str, str]) -> MapUncertainty:
    """Uncertainty of a settled fit.

    Raises:
        QualityGateError: the misses are large, or the motion leaves a parameter open.
    """
    residuals = fit.target.misses_mm(views.placed_mm(fit.parameters.estimate))
    rms = float(np.sqrt((residuals**2).sum(axis=1).mean()))
    if rms > options.max_rms_mm:
        raise QualityGateError(
            f"the frames that agree still miss the target by {rms:.2f} mm RMS, needed at most "
            f"{options.max_rms_mm:g} mm; check that the target stood still and that poses and images belong "
            "together"
        )
    jacobian = joint_jacobian(fit.parameters, fit.target, views)
    count = fit.parameters.count
    freedom = max(1, residuals.size - jacobian.shape[2])
    noise = max(options.least_noise_mm, float(np.sqrt((residuals**2).sum() / freedom)))
    limits = (
        float(np.radians(options.max_rotation_sd_deg)),
        options.max_position_sd_mm,
        options.max_scale_sd_percent / 100,
    )
    refuse_unconstrained(fit.parameters, jacobian, noise, limits, advice)
    covariance, held_out = piece_jackknife(jacobian, residuals)
    return MapUncertainty(
        fit.parameters, covariance[:count, :count], len(views), np.linalg.norm(held_out, axis=1)
    )


def _stepped(state: Fit[T], step: FloatArray) -> Fit[T]:
    parameters = state.parameters
    # rotations beyond 1 rad and sizes beyond a factor e a step leave the linear regime
    bounded = step.copy()
    turn = float(np.linalg.norm(step[:3]))
    if turn > 1.0:
        bounded[:3] /= turn
    bounded[6 : parameters.count] = np.clip(step[6 : parameters.count], -1.0, 1.0)
    moved = parameters.stepped(bounded[: parameters.count])
    return Fit(
        MapParameters(moved, parameters.center_px, parameters.isotropic),
        state.target.stepped(bounded[parameters.count :]),
        np.inf,
    )
