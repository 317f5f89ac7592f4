"""Image map and a fixed target (a point, a plane) together: least trimmed squares, then the inliers."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic

import numpy as np

from dvf_ig.calibration.inliers import InlierRule, fit_inliers
from dvf_ig.calibration.refusal import Gate, Refusal, RejectedFrame
from dvf_ig.core import (
    BoolArray,
    FloatArray,
    ImageMap,
    InvalidInputError,
    PoseStream,
    QualityGateError,
    Rigid,
    read_only_arrays,
)

from .covariance import MapUncertainty, block_jackknife, undetermined_refusals
from .errors import CalibrationErrors, calibration_errors
from .map_fit import MapFit, P, levenberg_marquardt, start_fit
from .tracked_points import TrackedPoints, rejected_frames

PIXEL_UNIT = 100.0
"""Pixels by which columns and rows are divided in linear solutions, so that all unknowns have one size."""


def centred_pixels(points: TrackedPoints) -> FloatArray:
    """Compute (f, k, 2) column, row from the middle of the region of the target, in PIXEL_UNIT."""
    return np.asarray((points.pixels - points.center_px) / PIXEL_UNIT)


def map_from_solution(solution: FloatArray, points: TrackedPoints) -> ImageMap:
    """Convert a free linear solution, whose first nine numbers are axes a, b and origin o, to an image map.

    Args:
        solution: (9 or more,) mm, for `centred_pixels`.
    """
    columns = solution[:9].reshape(3, 3).T / np.array([PIXEL_UNIT, PIXEL_UNIT, 1.0])
    columns[:, 2] -= columns[:, :2] @ points.center_px
    return _map_from_columns(columns, points.source)


def _map_from_columns(columns: FloatArray, sensor: str) -> ImageMap:
    """Approximate a (3, 3) linear map [u, v, 1] to mm, which may be far from orthogonal, by rotation · sizes.

    The bisector of the two axes is kept and both are rotated to 45° from it; an axis that is not determined
    (zero, or along the other one) becomes some direction across the other.
    """
    size = np.maximum(np.linalg.norm(columns[:, :2], axis=0), 1e-6)
    u, v = (columns[:, :2] / size).T
    if np.linalg.norm(np.cross(u, v)) < 1e-3:
        u = u / np.linalg.norm(u) if np.linalg.norm(u) > 0.5 else np.array([1.0, 0.0, 0.0])
        v = np.cross(u, np.eye(3)[int(np.abs(u).argmin())])
        v /= np.linalg.norm(v)
    along, across = u + v, u - v
    along, across = along / np.linalg.norm(along), across / np.linalg.norm(across)
    axes = np.column_stack([along + across, along - across]) / np.sqrt(2)
    rotation = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    return ImageMap(Rigid(sensor, "image", rotation, columns[:, 2]), size)


MAX_CONCENTRATION_STEPS = 12
LEAST_FRAMES = 12
"""Fewest agreeing frames that are fitted: the number of a cross-wire's unknowns."""
HYPOTHESES = 60
"""Random subsets of frames tried before the fit."""
SUBSET = 12
"""Frames in a subset."""
KEEP_SIGMA = 5.0
"""Frames whose residual is at most this many robust standard deviations long are inliers."""
MIN_FRAMES = 15
"""Fewest frames accepted."""
MAX_POSITION_SD_MM = 1.0
MAX_ROTATION_SD_DEG = 2.0
MAX_SCALE_SD_PERCENT = 5.0
"""Largest accepted standard deviations, of the middle of the region where the target was seen."""
LEAST_NOISE_MM = 0.1
"""Noise assumed for these standard deviations if residuals are smaller."""


@dataclass(frozen=True, slots=True)
class TargetOptions:
    """Options of the target fit and limits of its quality gates.

    Attributes:
        isotropic: one pixel size instead of two.
        max_rms_mm: largest accepted RMS residual of the inliers.
    """

    isotropic: bool = False
    max_rms_mm: float = 3.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TargetRecording:
    """A target seen in tracked images.

    Attributes:
        poses: (n,) tracker_from_probe, or against any frame in which the target does not move.
        points_px: (n, k, 2) column, row of the target's points; NaN if not found.
        usable: the frames that show all of them with a valid pose.
    """

    poses: PoseStream
    points_px: FloatArray
    usable: TrackedPoints


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TargetResult(Generic[P]):
    """An image calibration from a fixed target, with its evidence.

    Attributes:
        probe_from_image: rotation, translation and pixel size.
        target: the point or plane, in the poses' target frame.
        calibration: errors over every usable frame of the recording, outliers included.
        held_out: errors of the inliers, each under the calibration made without it.
        uncertainty: 95 % intervals.
        inliers: (n,) frames of the recording that took part.
        rejected: (frame, reason) of all others.
        refusals: the gates that the estimate failed; it must not be used unless there are none.
    """

    probe_from_image: ImageMap
    target: P
    calibration: CalibrationErrors
    held_out: CalibrationErrors
    uncertainty: MapUncertainty
    inliers: BoolArray
    rejected: tuple[tuple[int, RejectedFrame], ...]
    refusals: tuple[Refusal, ...] = ()


def best_start(
    starts: Iterable[tuple[ImageMap, P, FloatArray]], points: TrackedPoints, options: TargetOptions
) -> MapFit[P]:
    """Choose the fit of least trimmed cost from several starts.

    Args:
        starts: at least one map with its target and the residual lengths (f,) of the frames under it.
    """
    fits = (
        concentrate(
            start_fit(start, target, points, isotropic=options.isotropic),
            points,
            lengths <= np.median(lengths),
        )
        for start, target, lengths in starts
    )
    return min(fits, key=lambda fit: fit.cost)


def concentrate(start: MapFit[P], points: TrackedPoints, chosen: BoolArray) -> MapFit[P]:
    """Concentration steps: fit to the half of the frames with the smallest residuals until it is stable.

    Args:
        chosen: (f,) frames of the first step.
    Returns:
        The fit; its cost is that of the better half.
    Source: Rousseeuw & Van Driessen 2006 (C-steps of least trimmed squares).
    """
    half = max(len(points) // 2 + 1, min(len(points), 12))
    fit = start
    for _ in range(MAX_CONCENTRATION_STEPS):
        fit = levenberg_marquardt(fit, points.part(chosen), steps=15)
        order = np.argsort(fit.lengths(points), kind="stable")
        again = np.zeros(len(points), dtype=np.bool_)
        again[order[:half]] = True
        if np.array_equal(again, chosen):
            break
        chosen = again
    trimmed = np.sort(fit.lengths(points))[:half]
    return MapFit(fit.parameters, fit.phantom, float((trimmed**2).sum()))


def calibrate_target(
    start: MapFit[P], recording: TargetRecording, options: TargetOptions, advice: dict[str, str]
) -> TargetResult[P]:
    """Fit all inliers and assemble the evidence.

    Args:
        start: result of `best_start`.
        advice: which motion determines which parameter.
    Raises:
        QualityGateError: hardly a frame agrees with the others. What is computed but fails a gate (too few
            inliers, large residuals, a motion that leaves a parameter undetermined) carries its refusals.
    """
    points, frames = recording.usable, len(recording.poses)
    rule = InlierRule(KEEP_SIGMA, dimensions=start.residuals(points).shape[1])
    first, _ = rule.select([start.lengths(points)], np.ones(len(points), dtype=np.bool_))
    agreed = fit_inliers(
        lambda inliers, last: levenberg_marquardt(last or start, points.part(inliers)),
        lambda fit: [fit.lengths(points)],
        first,
        rule,
    )
    refusals = _few_agree(agreed.inliers)
    if agreed.model is None or agreed.inliers.sum() < LEAST_FRAMES:
        raise QualityGateError(_few_agree_text(agreed.inliers))
    fit = agreed.model
    uncertainty, unsure = _uncertainty(fit, points.part(agreed.inliers), options, advice)
    lengths = fit.lengths(points)
    per_point = np.sqrt(points.pixels.shape[1])
    return TargetResult(
        probe_from_image=fit.parameters.estimate,
        target=fit.phantom,
        calibration=calibration_errors(lengths / per_point, frames),
        held_out=calibration_errors(uncertainty.held_out_mm / per_point, frames),
        uncertainty=uncertainty,
        inliers=points.recorded(agreed.inliers, frames),
        rejected=_rejected(recording, lengths, agreed.limits[0]),
        refusals=refusals + unsure,
    )


def _few_agree(inliers: BoolArray) -> tuple[Refusal, ...]:
    if inliers.sum() >= max(MIN_FRAMES, len(inliers) // 2):
        return ()
    return (Refusal(Gate.FEW_AGREE, _few_agree_text(inliers)),)


def _few_agree_text(inliers: BoolArray) -> str:
    return (
        f"only {int(inliers.sum())} of {len(inliers)} frames agree on one calibration, needed "
        f"{max(MIN_FRAMES, len(inliers) // 2)}; check that the target stood still and that the "
        "points belong to these frames"
    )


def _uncertainty(
    fit: MapFit[P], points: TrackedPoints, options: TargetOptions, advice: dict[str, str]
) -> tuple[MapUncertainty, tuple[Refusal, ...]]:
    """Estimate the uncertainty of a converged fit and its refusals.

    Raises:
        QualityGateError: it is refused, and too weakly determined for an uncertainty.
        InvalidInputError: one block of frames alone determines an unknown.
    """
    residuals = fit.residuals(points)
    rms = float(np.sqrt((residuals**2).sum(axis=1).mean()))
    refusals: tuple[Refusal, ...] = ()
    if rms > options.max_rms_mm:
        detail = (
            f"the frames that agree still miss the target by {rms:.2f} mm RMS, above the gate of "
            f"{options.max_rms_mm:g} mm (--max-residual-mm moves it); check that the target stood "
            "still and that poses and images belong together"
        )
        refusals = (Refusal(Gate.RESIDUAL, detail),)
    jacobian = fit.phantom.jacobian(fit.parameters, points)
    count = fit.parameters.count
    freedom = max(1, residuals.size - jacobian.shape[2])
    noise = max(LEAST_NOISE_MM, float(np.sqrt((residuals**2).sum() / freedom)))
    limits = (
        float(np.radians(MAX_ROTATION_SD_DEG)),
        MAX_POSITION_SD_MM,
        MAX_SCALE_SD_PERCENT / 100,
    )
    refusals += undetermined_refusals(fit.parameters, jacobian, noise, limits, advice)
    try:
        covariance, held_out = block_jackknife(jacobian, residuals)
    except InvalidInputError as exc:
        if refusals:  # their advice is more specific
            raise QualityGateError("; ".join(refusal.detail for refusal in refusals)) from exc
        raise
    errors_mm = np.linalg.norm(held_out, axis=1)
    return MapUncertainty(fit.parameters, covariance[:count, :count], len(points), errors_mm), refusals


def _rejected(
    recording: TargetRecording, lengths_mm: FloatArray, limit_mm: float
) -> tuple[tuple[int, RejectedFrame], ...]:
    """List (frame, reason) of every frame of the recording that took no part in the fit."""
    outliers = {
        int(frame): f"it misses the target by {length:.2f} mm, others by at most {limit_mm:.2f} mm"
        for frame, length in zip(recording.usable.frames, lengths_mm, strict=True)
        if length > limit_mm
    }
    return rejected_frames(
        recording.poses, recording.points_px, outliers, lambda _: "the target was not found in the image"
    )
