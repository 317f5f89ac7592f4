"""Signed distance to the surface that ultrasound boundaries are registered to, phase by phase.

Either the blood pools of a label series (endocardium and vessels: the strong boundaries of ultrasound), or
the surface of a fixture model (the epicardium). Both are cubic splines of signed distance, positive inside.
Samples of the blood's distance serve as spline coefficients unfiltered: that smooths them by 0.58 voxels.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtri

from dvf_ig.core import (
    AnyArray,
    BoolArray,
    DvfModel,
    FloatArray,
    IntArray,
    InvalidInputError,
    VolumeSeries,
    nearest_phase,
    phase_at_rest,
    read_only_arrays,
)
from dvf_ig.core.progress import thread_pool
from dvf_ig.kernels.boundary import DistanceSplines, boundary_distances, foot_point_distance
from dvf_ig.kernels.compiled import thread_count
from dvf_ig.registration.lc2.channels import BLOOD

SMOOTHING_VOXELS = 0.8
"""Standard deviation of the Gaussian on the blood mask: its 0.5 level lies between voxels."""
PLANE_VOXELS = 3.0
"""Up to here the distance is that of a tangent plane; from three times as far that of a point."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BoundaryTarget:
    """The model's boundary: one spline of signed distance per phase.

    Attributes:
        frame: of the model.
        coefficients: (n, cx, cy, cz) float32 mm, as in `DvfModel`.
        knots_from_mm: (3, 4) knot coordinates from mm.
        fractions: (n,) when in the cycle each phase was taken.
        polarity: of the boundary, −1 if the inside is its dark side (blood), +1 if it is the bright one.
    """

    frame: str
    coefficients: NDArray[np.float32]
    knots_from_mm: FloatArray
    fractions: FloatArray
    polarity: float

    def distance(self, places_mm: FloatArray, phases: IntArray) -> tuple[FloatArray, FloatArray]:
        """(n,) signed distance, mm, and (n, 3) its gradient at places, each at a phase; 0 outside the box."""
        distance, gradient = np.empty(len(places_mm)), np.empty((len(places_mm), 3))
        boundary_distances(self.splines, phases, places_mm, distance, gradient)
        return distance, gradient

    def nearest_phase(self, model_phase: FloatArray) -> IntArray:
        """(n,) index of the phase nearest in the cycle."""
        return nearest_phase(self.fractions, model_phase)

    @property
    def splines(self) -> DistanceSplines:
        """The distance as kernels evaluate it."""
        return DistanceSplines(self.coefficients, self.knots_from_mm, self.polarity)

    @property
    def rest(self) -> int:
        """Index of the phase nearest to the R peak, from which the heart contracts."""
        return phase_at_rest(self.fractions)

    def contracting(self, contraction: float) -> "BoundaryTarget":
        """Return the boundary of a heart that contracts so many times as far."""
        at_rest, share = self.coefficients[self.rest], np.float32(contraction)
        return replace(self, coefficients=at_rest + share * (self.coefficients - at_rest))


def target_from_labels(labels: VolumeSeries, model_phase: FloatArray) -> BoundaryTarget:
    """The surface of the blood of a label series (0 outside, 1 wall, 2 blood), at the phases in use only.

    Args:
        model_phase: phases in use, any number and order.
    Raises:
        InvalidInputError: a used phase has no blood, or nothing else.
    """
    used = np.unique(nearest_phase(labels.timing.fractions, model_phase))
    grid = labels.grid
    with thread_pool(thread_count()) as pool:
        distance = np.stack(
            list(pool.map(lambda i: signed_distance_mm(labels.values[i] == BLOOD, grid.spacing_mm), used))
        )
    knots = np.empty((3, 4))
    knots[:, :3] = np.linalg.inv(grid.axes_mm)
    # coefficient j of a row is centred on knot coordinate j − 1
    knots[:, 3] = -knots[:, :3] @ grid.origin_mm - 1.0
    return BoundaryTarget(grid.frame, distance, knots, labels.timing.fractions[used], -1.0)


def target_from_model(model: DvfModel) -> BoundaryTarget:
    """The surface of a fixture model in darker surroundings."""
    knots = np.empty((3, 4))
    knots[:, :3] = np.eye(3) / model.knot_spacing_mm
    knots[:, 3] = -model.origin_mm / model.knot_spacing_mm
    return BoundaryTarget(model.frame, model.coefficients, knots, model.timing.fractions, 1.0)


def signed_distance_mm(inside: BoolArray, spacing_mm: FloatArray) -> NDArray[np.float32]:
    """Distance to the surface of a voxel mask, positive inside, to a tenth of a voxel.

    Beside the surface the smoothed mask is Φ(d/s) of a plane, with s² = smoothing² + voxel²/12: hence d,
    normal and foot point there. Any other voxel takes the nearest of those: it is as far as its tangent plane
    when near, as its foot point when far (where a plane beyond a bend of the surface misleads).
    """
    h = np.asarray(spacing_mm, dtype=np.float64)
    smoothing_mm = SMOOTHING_VOXELS * float(h.mean())
    soft = ndimage.gaussian_filter(inside.astype(np.float32), smoothing_mm / h)
    within = soft > 0.5
    beside = _beside_surface(within)
    if not beside.any():
        raise InvalidInputError("a phase of the label map has no blood or nothing else; check its labels")
    voxels = np.nonzero(beside)
    normals = _inward_normals(soft, voxels, h)
    spread_mm = np.sqrt(smoothing_mm**2 + np.square(normals * h).sum(axis=1) / 12)
    depth_mm = spread_mm * ndtri(np.clip(soft[voxels], 0.02, 0.98))
    row = np.zeros(soft.shape, dtype=np.int32)
    row[voxels] = np.arange(len(normals))
    nearest = ndimage.distance_transform_edt(~beside, sampling=h, return_distances=False, return_indices=True)
    out = np.empty(soft.shape, dtype=np.float32)
    feet_mm = normals * depth_mm[:, None]
    plane_mm = PLANE_VOXELS * float(h.mean())
    foot_point_distance(nearest, row, feet_mm, normals, within, h, plane_mm, out)
    return out


def _inward_normals(soft: NDArray[np.float32], voxels: tuple[AnyArray, ...], h: FloatArray) -> FloatArray:
    """(n, 3) unit gradient at some voxels, by central differences, one-sided at the border."""
    out = np.empty((len(voxels[0]), 3))
    for axis, step in enumerate(h):
        low, high = list(voxels), list(voxels)
        low[axis] = np.maximum(voxels[axis] - 1, 0)
        high[axis] = np.minimum(voxels[axis] + 1, soft.shape[axis] - 1)
        rise = soft[tuple(high)].astype(np.float64) - soft[tuple(low)]
        out[:, axis] = rise / (np.maximum(high[axis] - low[axis], 1) * step)
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9))


def _beside_surface(inside: AnyArray) -> BoolArray:
    """Voxels with a neighbour along an axis on the other side."""
    out = np.zeros(inside.shape, dtype=np.bool_)
    for axis in range(3):
        low = [slice(None)] * 3
        high = [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        change = inside[tuple(low)] != inside[tuple(high)]
        out[tuple(low)] |= change
        out[tuple(high)] |= change
    return out
