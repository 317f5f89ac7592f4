"""Spatial calibration of a tracked probe from one point (the crossing of two wires) seen in many images."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.random import Generator

from dvf_ig.core import (
    FloatArray,
    ImageMap,
    InvalidInputError,
    PoseStream,
    QualityGateError,
    read_only_arrays,
)

from .errors import CalibrationErrors, calibration_errors
from .map_parameters import MapParameters
from .target_fit import (
    HYPOTHESES,
    MIN_FRAMES,
    SUBSET,
    TargetOptions,
    TargetRecording,
    TargetResult,
    best_start,
    calibrate_target,
    centred_pixels,
    map_from_solution,
)
from .tracked_points import TrackedPoints, require_same_probe, usable_points

_MOVE = "let the crossing wander over the whole image, left and right, near and far"
_ROTATE = "turn and tilt the probe about all three axes while the crossing stays in the image"
ADVICE = {
    "about_lateral_rad": _MOVE,
    "about_axial_rad": _MOVE,
    "about_elevation_rad": _MOVE,
    "lateral_mm": _ROTATE,
    "axial_mm": _ROTATE,
    "elevation_mm": _ROTATE,
    "log_column_size": _MOVE,
    "log_row_size": _MOVE,
    "log_pixel_size": _MOVE,
}
"""Which motion determines which parameter."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PointTarget:
    """A point (3,) mm in the poses' target frame; a frame's residuals are its three coordinates."""

    xyz_mm: FloatArray

    def residuals(self, image_map: ImageMap, points: TrackedPoints) -> FloatArray:
        return np.asarray(points.placed_mm(image_map)[:, 0] - self.xyz_mm)

    def jacobian(self, parameters: MapParameters, points: TrackedPoints) -> FloatArray:
        by_map = points.placed_jacobian(parameters)[:, 0]
        return np.concatenate([by_map, np.broadcast_to(-np.eye(3), (len(points), 3, 3))], axis=2)

    def stepped(self, step: FloatArray) -> Self:
        return type(self)(self.xyz_mm + step)


def calibrate_crosswire(
    poses: PoseStream, points_px: FloatArray, *, rng: Generator, options: TargetOptions | None = None
) -> TargetResult[PointTarget]:
    """Fit probe_from_image and the crossing's position together; no initial guess is needed.

    R_i (a u_i + b v_i + o) + t_i = q is linear in the image's axes a, b, its origin o and the crossing q:
    free solutions of random subsets of frames start a search on the better half of the frames, then all
    inliers are fitted.

    Args:
        poses: (n frames) tracker_from_probe, or against any frame in which the phantom does not move.
        points_px: (n, 1, 2) column, row of the crossing; NaN if not found.
        rng: draws subsets of frames.
        options: see TargetOptions.
    Raises:
        InvalidInputError: points of another recording, or too few usable frames.
        QualityGateError: frames that do not agree, a large error, or a motion that does not determine a
            parameter.
    Source: Detmer 1994, Prager 1998 (cross-wire).
    """
    options = options or TargetOptions()
    points = _checked(poses, points_px, MIN_FRAMES)
    design, right = _linear_rows(points)
    size = min(SUBSET, len(points))
    picks = [np.sort(rng.permutation(len(points))[:size]) for _ in range(HYPOTHESES)]
    solved: list[FloatArray] = [
        np.linalg.lstsq(design[p].reshape(-1, 12), right[p].ravel(), rcond=1e-10)[0].astype(np.float64)
        for p in picks
    ]
    lengths = [np.linalg.norm(design @ x - right, axis=1) for x in solved]
    ranked = sorted(range(len(solved)), key=lambda k: float(np.median(lengths[k])))
    starts = [
        (map_from_solution(solved[k], points), PointTarget(solved[k][9:]), lengths[k]) for k in ranked[:3]
    ]
    recording = TargetRecording(poses, points_px, points)
    return calibrate_target(best_start(starts, points, options), recording, options, ADVICE)


def validate_crosswire(
    probe_from_image: ImageMap, poses: PoseStream, points_px: FloatArray
) -> tuple[CalibrationErrors, FloatArray]:
    """Reconstruct the crossing from every usable frame of another recording and measure the spread.

    Returns:
        Distances from the median of the positions at which the frames put the crossing, and that median (3,).
    Raises:
        InvalidInputError: no usable frame, or a calibration of another sensor.
    """
    require_same_probe(probe_from_image, poses)
    placed = _checked(poses, points_px, 2).placed_mm(probe_from_image)[:, 0]
    middle = np.median(placed, axis=0)
    return calibration_errors(np.linalg.norm(placed - middle, axis=1), len(poses)), middle


def _checked(poses: PoseStream, points_px: FloatArray, least: int) -> TrackedPoints:
    points = usable_points(poses, points_px, least)
    if points.pixels.shape[1] != 1:
        raise InvalidInputError(
            f"each frame has {points.pixels.shape[1]} points; a cross-wire shows 1 (column1_px, row1_px)"
        )
    if np.ptp(points.pixels.reshape(-1, 2), axis=0).max() < 1.0:
        raise QualityGateError(f"the crossing stays at one pixel in all {len(points)} frames; {_MOVE}")
    return points


def _linear_rows(points: TrackedPoints) -> tuple[FloatArray, FloatArray]:
    """(f, 3, 12) rows of R a u + R b v + R o − q = −t, with u and v centred and in hundreds of pixels."""
    u, v = centred_pixels(points)[:, 0].T[..., None, None]
    rotations = points.rotations
    minus = np.broadcast_to(-np.eye(3), rotations.shape)
    return np.concatenate([rotations * u, rotations * v, rotations, minus], axis=2), -points.translations_mm
