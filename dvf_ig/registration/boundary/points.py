"""Boundary points between blood and wall in tracked ultrasound slices, with their normals.

A boundary is where the smoothed grey level u rises fastest along its own gradient (Canny 1986), found to a
part of a pixel, with relative contrast c = σ|∇u|/u above a threshold. A step from a to b has
c = 0.8 (b − a)/(b + a) there: about 0.35 between blood and muscle 24 of 60 dB apart.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError, read_only_arrays
from dvf_ig.kernels.boundary import DistanceSplines, boundary_distances
from dvf_ig.registration.lc2.slices import SliceSet, subsample

PATCH_MM, PATCH_PITCH_MM = 9.0, 1.5
"""Half the edge and the pitch of the patch of the model about a place, three times the smoothing."""
EDGE_MM, EDGE_STEPS = 4.0, 33
LEAST_EDGE = 0.2
"""Share of the steepest place that an edge has at least."""
FULL_CONTRAST = 0.2
"""Boundaries above this count alike: weighting by contrast would drop the hazy walls of a poor image."""

SMOOTHING_MM = 3.0
"""Standard deviation of the Gaussian before the gradient. This and the next three values come from tuning
seeds 101–103 of the synthetic world."""
MIN_CONTRAST = 0.12
"""Least relative contrast of a boundary."""
MIN_SUPPORT = 0.9
"""Least share of the Gaussian that must be inside the sector."""
MOST_POINTS = 4000
"""Most points that are kept, evenly spread."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BoundaryPoints:
    """Oriented points of the boundary, found in ultrasound slices.

    Attributes:
        frame: of points and normals, that of the slices.
        points_mm: (n, 3).
        normals: (n, 3) unit, in the slice's plane, from dark (blood) to bright (wall).
        planes: (n, 3) unit normals of the slices.
        model_phase: (n,) where in the model's cycle each was seen.
        weights: (n,) relative contrast over FULL_CONTRAST, at most 1.
    """

    frame: str
    points_mm: FloatArray
    normals: FloatArray
    planes: FloatArray
    model_phase: FloatArray
    weights: FloatArray

    def __len__(self) -> int:
        return len(self.points_mm)

    def subsampled(self, count: int) -> "BoundaryPoints":
        """At most `count` of the points, evenly spread."""
        return self.subset(subsample(len(self), count))

    def subset(self, keep: IntArray | BoolArray) -> "BoundaryPoints":
        """Some of the points."""
        return BoundaryPoints(
            self.frame,
            self.points_mm[keep],
            self.normals[keep],
            self.planes[keep],
            self.model_phase[keep],
            self.weights[keep],
        )


def boundary_points(slices: SliceSet) -> BoundaryPoints:
    """Boundary points of all slices, at most MOST_POINTS; none where they show no boundary.

    Raises:
        InvalidInputError: the slices differ in pitch.
    """
    pitch = _pitch_mm(slices)
    smooth, usable = _smoothed(slices, pitch)
    gradient = np.stack([_central(smooth, axis) / np.float32(pitch[axis]) for axis in (0, 1)])
    magnitude = np.hypot(gradient[0], gradient[1])
    steep = np.nonzero(usable & (SMOOTHING_MM * magnitude > MIN_CONTRAST * smooth))
    # per pixel, so that a step along it is a step along the gradient in mm
    along = np.stack([gradient[axis][steep] / pitch[axis] for axis in (0, 1)], axis=1).astype(np.float64)
    keep, part = _maxima(magnitude, steep, along)
    s, row, col = (index[keep] for index in steep)
    along, contrast = along[keep], SMOOTHING_MM * magnitude[s, row, col] / smooth[s, row, col]
    place = np.column_stack([col + part[keep, 1], row + part[keep, 0], np.ones(len(s))])
    normals = np.einsum("nij,nj->ni", slices.frame_from_pixel[s][:, :, :2], along[:, ::-1])
    planes = np.cross(slices.frame_from_pixel[:, :, 0], slices.frame_from_pixel[:, :, 1])
    return BoundaryPoints(
        slices.frame,
        np.einsum("nij,nj->ni", slices.frame_from_pixel[s], place),
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        (planes / np.linalg.norm(planes, axis=1, keepdims=True))[s],
        slices.model_phase[s],
        np.minimum(contrast / FULL_CONTRAST, 1.0).astype(np.float64),
    ).subsampled(MOST_POINTS)


def _smoothed(slices: SliceSet, pitch_mm: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(s, rows, columns) Gaussian mean of what lies inside the sector, and where enough of it does."""
    sigma = (0.0, SMOOTHING_MM / pitch_mm[0], SMOOTHING_MM / pitch_mm[1])
    support, smooth = (
        ndimage.gaussian_filter(stack, sigma, mode="constant", truncate=3.0)
        for stack in (slices.masks.astype(np.float32), slices.images)
    )
    smooth /= np.maximum(support, np.float32(1e-3))
    usable = slices.masks & (support >= MIN_SUPPORT)
    usable[:, [0, -1], :] = False
    usable[:, :, [0, -1]] = False
    return smooth, usable


def _pitch_mm(slices: SliceSet) -> FloatArray:
    """(2,) mm from row to row and from column to column, the same for all slices."""
    pitch = np.linalg.norm(slices.frame_from_pixel[:, :, :2], axis=1)
    if np.ptp(pitch, axis=0).max() > 0.01 * pitch.min():
        raise InvalidInputError(
            f"pixel pitches of the slices run from {pitch.min():.3g} to {pitch.max():.3g} mm; "
            "prepare them at one pitch"
        )
    return np.asarray(pitch[0, ::-1])


def _central(stack: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Central difference per pixel of every image, from row to row (0) or column to column (1)."""
    out = np.zeros_like(stack)
    if axis == 0:
        out[:, 1:-1] = 0.5 * (stack[:, 2:] - stack[:, :-2])
    else:
        out[:, :, 1:-1] = 0.5 * (stack[:, :, 2:] - stack[:, :, :-2])
    return out


def _maxima(
    magnitude: NDArray[np.float32], steep: tuple[NDArray[np.intp], ...], along: FloatArray
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which pixels are maxima along (n, 2) rows and columns; (n, 2) way to the maximum of a parabola."""
    step = along / np.linalg.norm(along, axis=1, keepdims=True)
    at = np.stack(steep).astype(np.float64)
    ahead = np.vstack([np.zeros((1, len(step))), step.T])
    before, after = (
        ndimage.map_coordinates(magnitude, at + sign * ahead, order=1, output=np.float64)
        for sign in (-1.0, 1.0)
    )
    here = magnitude[steep].astype(np.float64)
    keep = (here >= before) & (here > after)
    bend = np.minimum(before - 2 * here + after, -1e-12)
    part = np.where(keep, np.clip(0.5 * (before - after) / bend, -0.5, 0.5), 0.0)
    return keep, part[:, None] * step


def edges_of_model_mm(
    splines: DistanceSplines, feet_mm: FloatArray, normals: FloatArray, planes: FloatArray, phases: IntArray
) -> FloatArray:
    """Compute where `boundary_points` would find the model's boundary near (n, 3) places on it.

    Smoothing moves the steepest place off a boundary that bends, or that has another near it.

    Args:
        feet_mm: places on the boundary, target frame.
        normals, planes: (n, 3) as in `BoundaryPoints`, target frame.
        phases: (n,) index of the spline of each place.
    Returns:
        (n,) displacement along the normals; NaN where no boundary is found within EDGE_MM.
    """
    sigma = SMOOTHING_MM
    axis = np.arange(-PATCH_MM, PATCH_MM + 0.5 * PATCH_PITCH_MM, PATCH_PITCH_MM)
    along, across = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    places = (
        feet_mm[:, None]
        + along[:, None] * normals[:, None]
        + across[:, None] * np.cross(planes, normals)[:, None]
    ).reshape(-1, 3)
    distance, gradient = np.empty(len(places)), np.empty((len(places), 3))
    boundary_distances(splines, np.repeat(phases, len(along)), places, distance, gradient)
    bright = np.clip(splines.polarity * distance / PATCH_PITCH_MM, -0.5, 0.5).reshape(len(feet_mm), -1)
    steps = np.linspace(-EDGE_MM, EDGE_MM, EDGE_STEPS)
    apart = along[:, None] - steps
    slope = bright @ (apart * np.exp(-0.5 * (apart**2 + across[:, None] ** 2) / sigma**2))
    before, here, after = slope[:, :-2], slope[:, 1:-1], slope[:, 2:]
    highest = (here >= before) & (here > after) & (here > LEAST_EDGE * slope.max(axis=1, keepdims=True))
    nearest = np.where(highest, np.abs(steps[1:-1]), np.inf)
    k = np.argmin(nearest, axis=1)
    rows = np.arange(len(k))
    bend = np.minimum((before + after - 2.0 * here)[rows, k], -1e-12)
    part = 0.5 * (before - after)[rows, k] / bend
    edges = steps[1:-1][k] + part * (steps[1] - steps[0])
    return np.where(np.isfinite(nearest[rows, k]), edges, np.nan)
