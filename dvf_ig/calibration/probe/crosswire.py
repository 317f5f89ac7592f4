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

from .target_fit import ProbeTargetResult, TargetOptions, agreeing, finished
from .target_start import best_start, centred_pixels, map_from_solution
from .target_views import TargetErrors, Views, same_sensor, target_errors, usable_views

_MOVE = "let the crossing wander over the whole image, left and right, near and far"
_TURN = "turn and tilt the probe about all three axes while the crossing stays in the image"
ADVICE = {
    "about_lateral_rad": _MOVE,
    "about_axial_rad": _MOVE,
    "about_elevation_rad": _MOVE,
    "lateral_mm": _TURN,
    "axial_mm": _TURN,
    "elevation_mm": _TURN,
    "log_column_size": _MOVE,
    "log_row_size": _MOVE,
    "log_pixel_size": _MOVE,
}
"""Which motion determines which parameter."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PointTarget:
    """A point (3,) mm in the poses' target frame; the misses are its three coordinates."""

    xyz_mm: FloatArray

    def misses_mm(self, placed_mm: FloatArray) -> FloatArray:
        return np.asarray(placed_mm[:, 0] - self.xyz_mm)

    def slope(self, placed_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        count = len(placed_mm)
        return (
            np.broadcast_to(np.eye(3)[:, None, :], (count, 3, 1, 3)),
            np.broadcast_to(-np.eye(3), (count, 3, 3)),
        )

    def stepped(self, step: FloatArray) -> Self:
        return type(self)(self.xyz_mm + step)


def calibrate_crosswire(
    poses: PoseStream, points_px: FloatArray, *, rng: Generator, options: TargetOptions | None = None
) -> ProbeTargetResult[PointTarget]:
    """Fit probe_from_image and the crossing's place together; no initial guess is needed.

    R_i (a u_i + b v_i + o) + t_i = q is linear in the image's axes a, b, its origin o and the crossing q:
    free solutions of random subsets of frames start a search on the better half of the frames, then all
    frames that agree count.

    Args:
        poses: (n frames) tracker_from_probe, or against any frame in which the phantom stands still.
        points_px: (n, 1, 2) column, row of the crossing; NaN where it was not found.
        rng: draws subsets of frames.
        options: see TargetOptions.
    Raises:
        InvalidInputError: points of another recording, or too few usable frames.
        QualityGateError: frames that do not agree, a large error, or a motion that leaves a parameter open.
    Source: Detmer 1994, Prager 1998 (cross-wire).
    """
    options = options or TargetOptions()
    views = _checked(poses, points_px, options.min_frames)
    design, right = _linear_rows(views)
    size = min(options.subset, len(views))
    picks = [np.sort(rng.permutation(len(views))[:size]) for _ in range(options.hypotheses)]
    solved: list[FloatArray] = [
        np.linalg.lstsq(design[p].reshape(-1, 12), right[p].ravel(), rcond=1e-10)[0].astype(np.float64)
        for p in picks
    ]
    misses = [np.linalg.norm(design @ x - right, axis=1) for x in solved]
    ranked = sorted(range(len(solved)), key=lambda k: float(np.median(misses[k])))
    starts = [
        (map_from_solution(solved[k], views), PointTarget(solved[k][9:]), misses[k]) for k in ranked[:3]
    ]
    fit, keep, limit = agreeing(best_start(starts, views, options), views, options)
    return finished(fit, poses, points_px, views, keep, limit, options, ADVICE)


def validate_crosswire(
    probe_from_image: ImageMap, poses: PoseStream, points_px: FloatArray
) -> tuple[TargetErrors, FloatArray]:
    """Spread of a crossing reconstructed from every usable frame of another recording; none is rejected.

    Returns:
        The distances from the median of the places where the frames put the crossing, and that place (3,).
    Raises:
        InvalidInputError: no usable frame, or a calibration of another sensor.
    """
    same_sensor(probe_from_image, poses)
    placed = _checked(poses, points_px, 2).placed_mm(probe_from_image)[:, 0]
    middle = np.median(placed, axis=0)
    return target_errors(np.linalg.norm(placed - middle, axis=1), len(poses)), middle


def _checked(poses: PoseStream, points_px: FloatArray, least: int) -> Views:
    views = usable_views(poses, points_px, least)
    if views.pixels.shape[1] != 1:
        raise InvalidInputError(
            f"each frame has {views.pixels.shape[1]} points; a cross-wire shows 1 (column1_px, row1_px)"
        )
    if np.ptp(views.pixels.reshape(-1, 2), axis=0).max() < 1.0:
        raise QualityGateError(f"the crossing stays at one pixel in all {len(views)} frames; {_MOVE}")
    return views


def _linear_rows(views: Views) -> tuple[FloatArray, FloatArray]:
    """(f, 3, 12) rows of R a u + R b v + R o − q = −t, with u and v centred and in hundreds of pixels."""
    u, v = centred_pixels(views)[:, 0].T[..., None, None]
    turn = views.rotations
    minus = np.broadcast_to(-np.eye(3), turn.shape)
    return np.concatenate([turn * u, turn * v, turn, minus], axis=2), -views.translations_mm
