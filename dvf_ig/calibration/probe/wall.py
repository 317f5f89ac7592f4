"""Spatial calibration of a tracked probe from a flat wall that shows as a line in each image."""

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
from .map_fit import MapFit
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

NORMALS = 240
"""Directions tried for the wall's normal: a hemisphere in steps of about 9°."""
_TILT_SIDE = "tilt the probe further to both sides"
_TILT_FORE = "tilt the probe further fore and aft"
_DEPTH = "hold the probe at more different distances from the wall"
ADVICE = {
    "about_lateral_rad": f"{_TILT_FORE} at different distances",
    "about_axial_rad": f"{_TILT_SIDE} while it is tilted fore and aft",
    "about_elevation_rad": f"{_TILT_SIDE} at different distances",
    "lateral_mm": _TILT_SIDE,
    "axial_mm": f"{_TILT_SIDE} and {_TILT_FORE.removeprefix('tilt the probe further ')}, to 30° or more",
    "elevation_mm": _TILT_FORE,
    "log_column_size": _TILT_SIDE,
    "log_row_size": _DEPTH,
    "log_pixel_size": _DEPTH,
}
"""Which motion determines which parameter."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PlaneTarget:
    """A plane in the poses' target frame; residuals are the signed distances of the line's two points.

    Attributes:
        normal: (3,) unit.
        point_mm: (3,) a point of the plane, near the points seen.
    """

    normal: FloatArray
    point_mm: FloatArray

    @property
    def offset_mm(self) -> float:
        """normal · x on the plane."""
        return float(self.normal @ self.point_mm)

    def distances_mm(self, placed_mm: FloatArray) -> FloatArray:
        """(…,) signed distances of points (…, 3)."""
        return np.asarray((placed_mm - self.point_mm) @ self.normal)

    def residuals(self, image_map: ImageMap, points: TrackedPoints) -> FloatArray:
        return self.distances_mm(points.placed_mm(image_map))

    def jacobian(self, parameters: MapParameters, points: TrackedPoints) -> FloatArray:
        by_map = np.einsum("i,fkip->fkp", self.normal, points.placed_jacobian(parameters))
        tilts = (points.placed_mm(parameters.estimate) - self.point_mm) @ self._tangents.T
        return np.concatenate([by_map, tilts, np.full((*tilts.shape[:2], 1), -1.0)], axis=2)

    def stepped(self, step: FloatArray) -> Self:
        tilted = self.normal + step[:2] @ self._tangents
        return type(self)(tilted / np.linalg.norm(tilted), self.point_mm + step[2] * self.normal)

    @property
    def _tangents(self) -> FloatArray:
        """(2, 3) unit vectors along the plane."""
        least = np.eye(3)[int(np.abs(self.normal).argmin())]
        first = np.cross(self.normal, least)
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])


def calibrate_wall(
    poses: PoseStream, points_px: FloatArray, *, rng: Generator, options: TargetOptions | None = None
) -> TargetResult[PlaneTarget]:
    """Fit probe_from_image and the wall together; no initial guess is needed.

    For a given normal n, n·(R_i (a u + b v + o) + t_i) = d is linear in the image's axes a, b, its origin o
    and the wall's offset d: normals in all directions, with random subsets of frames, start a search on the
    better half of the frames, then all inliers are fitted.

    Args:
        poses: (n frames) tracker_from_probe, or against any frame in which the wall does not move.
        points_px: (n, 2, 2) column, row of two points of the wall's line; NaN if not found.
        rng: draws subsets of frames.
        options: see TargetOptions.
    Raises:
        InvalidInputError: points of another recording, or too few usable frames.
        QualityGateError: frames that do not agree, a large error, or a motion that does not determine a
            parameter.
    Source: Prager 1998 (single wall).
    """
    options = options or TargetOptions()
    points = _checked(poses, points_px, MIN_FRAMES)
    best = best_start(_starts(points, rng), points, options)
    _refuse_collapsed(best, points)
    return calibrate_target(best, TargetRecording(poses, points_px, points), options, ADVICE)


def validate_wall(
    probe_from_image: ImageMap, poses: PoseStream, points_px: FloatArray
) -> tuple[CalibrationErrors, PlaneTarget]:
    """Reconstruct the wall from every usable frame of another recording and measure its flatness.

    Returns:
        The RMS distances of the frames' points from the plane through all of them, and that plane.
    Raises:
        InvalidInputError: no usable frame, or a calibration of another sensor.
    """
    require_same_probe(probe_from_image, poses)
    placed = _checked(poses, points_px, 3).placed_mm(probe_from_image)
    flat = placed.reshape(-1, 3)
    middle = flat.mean(axis=0)
    plane = PlaneTarget(np.linalg.svd(flat - middle, full_matrices=False)[2][2], middle)
    rms = np.sqrt((plane.distances_mm(placed) ** 2).mean(axis=1))
    return calibration_errors(rms, len(poses)), plane


def _checked(poses: PoseStream, points_px: FloatArray, least: int) -> TrackedPoints:
    points = usable_points(poses, points_px, least)
    if points.pixels.shape[1] != 2:
        raise InvalidInputError(
            f"each frame has {points.pixels.shape[1]} points; a wall's line is given by 2 "
            "(column1_px, row1_px, column2_px, row2_px)"
        )
    return points


def _refuse_collapsed(fit: MapFit[PlaneTarget], points: TrackedPoints) -> None:
    """Refuse an image of zero size, which fits any motion that keeps one point of the sensor in a plane."""
    extent = np.ptp(points.pixels.reshape(-1, 2), axis=0) * fit.parameters.estimate.scale_mm_per_px
    if extent.max() < 1.0:
        raise QualityGateError(
            "the probe's motion fits an image without any size as well as the wall: a point of the sensor "
            "stayed in one plane; move the probe along the wall in both directions, and to other distances"
        )


def _starts(points: TrackedPoints, rng: Generator) -> list[tuple[ImageMap, PlaneTarget, FloatArray]]:
    """Find the best free linear solutions over normals and subsets, with their (f,) residual lengths."""
    normals = _hemisphere(NORMALS)
    design, right = _linear_rows(points, normals)
    size = min(SUBSET, len(points))
    member = np.zeros((HYPOTHESES, len(points)))
    for row in member:
        row[rng.permutation(len(points))[:size]] = 1.0
    normal = np.einsum("nfki,nfkj->nfij", design, design)
    gradient = np.einsum("nfki,nfk->nfi", design, right)
    matrices = np.einsum("hf,nfij->nhij", member, normal, optimize=True)
    vectors = np.einsum("hf,nfi->nhi", member, gradient, optimize=True)
    ridge = 1e-9 * np.trace(matrices, axis1=2, axis2=3)[..., None, None] * np.eye(10)
    solved = np.linalg.solve(matrices + ridge, vectors[..., None])[..., 0]
    lengths = np.linalg.norm(
        np.einsum("nfki,nhi->nhfk", design, solved, optimize=True) - right[:, None], axis=3
    )
    score = np.median(lengths, axis=2)
    best_subset = score.argmin(axis=1)
    ranked = np.argsort(score[np.arange(len(normals)), best_subset])[:4]
    out = []
    for n in ranked:
        h = int(best_subset[n])
        image_map = map_from_solution(solved[n, h], points)
        seen = points.placed_mm(image_map).reshape(-1, 3)
        middle = np.median(seen, axis=0)
        point = middle + (solved[n, h, 9] - normals[n] @ middle) * normals[n]
        out.append((image_map, PlaneTarget(normals[n], point), lengths[n, h]))
    return out


def _linear_rows(points: TrackedPoints, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, f, 2, 10) rows of nᵀR a u + nᵀR b v + nᵀR o − d = −nᵀt, pixels centred and in hundreds."""
    facing = np.einsum("ni,fij->nfj", normals, points.rotations)[:, :, None]
    u, v = np.moveaxis(centred_pixels(points), 2, 0)[..., None]
    shape = (len(normals), *points.pixels.shape[:2])
    rows = [facing * u, facing * v, np.broadcast_to(facing, (*shape, 3)), np.full((*shape, 1), -1.0)]
    right = -np.einsum("ni,fi->nf", normals, points.translations_mm)
    return np.concatenate(rows, axis=3), np.broadcast_to(right[:, :, None], shape)


def _hemisphere(count: int) -> FloatArray:
    """(count, 3) unit vectors spread evenly over half the sphere (golden-angle spiral)."""
    height = (np.arange(count) + 0.5) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
