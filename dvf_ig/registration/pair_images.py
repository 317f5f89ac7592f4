"""What of a pair of 3-D images is registered: the eroded fan at one pitch, the anatomy around it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import (
    AnyArray,
    BoolArray,
    FloatArray,
    Grid,
    IntArray,
    InvalidInputError,
    Rigid,
    Volume,
    read_only_arrays,
)
from dvf_ig.registration.lc2.slices import SliceSet, slices_of_volume

PLANES = 14
"""About this many planes are kept along each axis of the ultrasound volume."""
EROSION_MM = 2.5
"""The outermost layer of the fan is left out: the scanner's blending there is no anatomy."""
GAP_MM = 2.0
"""Dark gaps up to twice this wide between non-zero voxels belong to the fan."""
_VOXELS_PER_PITCH = 1.25
"""The anatomy is averaged down to this many voxels a pitch where it is finer."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FanVolume:
    """A 3-D ultrasound image at one isotropic pitch.

    Attributes:
        grid: isotropic, cut to the fan.
        values: (nx, ny, nz) float32 of unit variance, NaN where nothing was insonified.
    """

    grid: Grid
    values: NDArray[np.float32]

    @property
    def pitch_mm(self) -> float:
        return float(self.grid.spacing_mm[0])

    @property
    def insonified(self) -> BoolArray:
        return np.isfinite(self.values)

    @property
    def radius_mm(self) -> float:
        """RMS distance of what was insonified from its middle."""
        points = self.points_mm(5000)
        return float(np.sqrt(np.square(points - points.mean(axis=0)).sum(axis=1).mean()))

    def slices(self) -> SliceSet:
        """Planes along the three axes."""
        every = max(1, max(self.grid.shape) // PLANES)
        grid = self.grid
        return slices_of_volume(self.values, grid.axes_mm, grid.origin_mm, every=every, frame=grid.frame)

    def cut(self, axis: int, begin: int, end: int) -> "FanVolume":
        """The part of the fan with begin <= index < end along an axis."""
        place = np.arange(self.grid.shape[axis])
        inside = ((place >= begin) & (place < end)).reshape([-1 if a == axis else 1 for a in range(3)])
        return FanVolume(self.grid, np.where(inside, self.values, np.float32(np.nan)))

    def points_mm(self, count: int) -> FloatArray:
        """(about `count`, 3) insonified places in mm, evenly subsampled."""
        index = np.argwhere(self.insonified)
        return self.grid.to_mm(index[:: max(1, len(index) // count)].astype(np.float64))


def usable_voxels(ultrasound: Volume, mask: Volume | None) -> BoolArray:
    """Voxels of the ultrasound image that may be used.

    Raises:
        InvalidInputError: none, or a mask on another grid.
    """
    usable = np.isfinite(ultrasound.values) & (ultrasound.values != 0)
    if mask is not None:
        theirs, ours = mask.grid, ultrasound.grid
        if theirs.shape != ours.shape or not np.allclose(
            [theirs.to_mm(corner) for corner in _corners(theirs.shape)],
            [ours.to_mm(corner) for corner in _corners(ours.shape)],
            atol=0.1 * float(ours.spacing_mm.min()),
        ):
            raise InvalidInputError(
                f"the mask has shape {theirs.shape} at {_text(theirs.origin_mm)} mm, the fixed image "
                f"{ours.shape} at {_text(ours.origin_mm)} mm; resample the mask onto the fixed image's grid"
            )
        usable &= mask.values != 0
    if not usable.any():
        raise InvalidInputError("the fixed image has no non-zero voxel inside its mask")
    return np.asarray(usable)


def extent_mm(ultrasound: Volume, usable: BoolArray) -> float:
    """Longest edge of the box around what was insonified."""
    return float(
        max((s.stop - s.start) * h for s, h in zip(_box(usable), ultrasound.grid.spacing_mm, strict=True))
    )


def fan_volume(ultrasound: Volume, usable: BoolArray, pitch_mm: float) -> FanVolume:
    """The ultrasound averaged down to `pitch_mm`, dark gaps filled, the fan eroded.

    Raises:
        InvalidInputError: nothing is left of the fan.
    """
    box = _wider(_box(usable), ultrasound.grid, EROSION_MM + pitch_mm)
    inside = usable[box].astype(np.float32)
    values = np.where(usable[box], ultrasound.values[box], 0).astype(np.float32)
    low = np.array([s.start for s in box], dtype=np.float64)
    zoom = ultrasound.grid.spacing_mm / pitch_mm
    shape = tuple(
        int(n) for n in np.maximum(1, np.floor((np.array(values.shape) - 1) * zoom).astype(int) + 1)
    )
    grid = Grid(
        ultrasound.grid.frame,
        (shape[0], shape[1], shape[2]),
        ultrasound.grid.to_mm(low),
        np.full(3, pitch_mm),
        ultrasound.grid.direction,
    )
    blur = np.where(zoom < 1, 0.5 / zoom, 0.0)
    inside_share, level = (_sampled(image, blur, zoom, shape) for image in (inside, values))
    fan = _eroded(_filled(inside_share > 0.5, pitch_mm), pitch_mm)
    if not fan.any():
        raise InvalidInputError(
            f"nothing is left of the ultrasound fan at a pitch of {pitch_mm:g} mm after an erosion by "
            f"{EROSION_MM:g} mm; give a larger image or mask"
        )
    # gaps in the fan were dark, and count as 0
    scale = float(level[fan].std())
    if not scale > 0:
        raise InvalidInputError(
            "the fixed image has one value throughout its fan; needed an ultrasound image"
        )
    return FanVolume(grid, np.where(fan, level / scale, np.nan).astype(np.float32))


def anatomy_around(anatomy: Volume, fan: FanVolume, start: Rigid, reach_mm: float) -> Volume:
    """The part of the anatomy within `reach_mm` of the fan at the start pose, not finer than needed.

    Raises:
        InvalidInputError: it holds voxels that are no numbers, or one value only.
    """
    places = anatomy.grid.to_index(start.apply_array(fan.points_mm(5000)))
    margin = reach_mm / anatomy.grid.spacing_mm
    top: IntArray = np.array(anatomy.grid.shape, dtype=np.int64)
    low = np.clip(np.floor(places.min(axis=0) - margin), 0, top - 1).astype(int)
    high = np.clip(np.ceil(places.max(axis=0) + margin) + 1, low + 1, top).astype(int)
    step = np.maximum(1, (fan.pitch_mm / _VOXELS_PER_PITCH / anatomy.grid.spacing_mm).astype(int))
    step = np.minimum(step, high - low)
    high = low + (high - low) // step * step
    part = anatomy.values[low[0] : high[0], low[1] : high[1], low[2] : high[2]].astype(np.float32)
    if not np.isfinite(part).all():
        raise InvalidInputError(
            f"{int((~np.isfinite(part)).sum())} voxels of the moving image are no numbers; replace them, "
            "for instance by the background's value"
        )
    if part.min() == part.max():
        raise InvalidInputError("the moving image has one value around the ultrasound; needed anatomy")
    count = (high - low) // step
    blocks = part.reshape(count[0], step[0], count[1], step[1], count[2], step[2]).mean(axis=(1, 3, 5))
    grid = Grid(
        anatomy.grid.frame,
        (int(count[0]), int(count[1]), int(count[2])),
        anatomy.grid.to_mm(low + (step - 1) / 2),
        anatomy.grid.spacing_mm * step,
        anatomy.grid.direction,
    )
    return Volume(grid, blocks)


def share_inside(anatomy: Volume, fan: FanVolume, pose: Rigid) -> float:
    """Share of the fan that lies inside the anatomy's box."""
    places = anatomy.grid.to_index(pose.apply_array(fan.points_mm(5000)))
    return float(anatomy.grid.holds(places).mean())


def _sampled(
    image: NDArray[np.float32], blur: FloatArray, zoom: FloatArray, shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """`image` blurred, at `shape` nodes one pitch apart."""
    smooth = ndimage.gaussian_filter(image, blur, mode="nearest")
    return np.asarray(
        ndimage.affine_transform(smooth, 1.0 / zoom, output_shape=shape, order=1, mode="nearest")
    )


def _filled(fan: BoolArray, pitch_mm: float) -> BoolArray:
    """The fan with dark gaps and enclosed dark regions."""
    gap = max(1, round(GAP_MM / pitch_mm))
    padded = np.pad(fan, gap)
    closed = ndimage.binary_closing(padded, iterations=gap)[gap:-gap, gap:-gap, gap:-gap]
    return np.asarray(ndimage.binary_fill_holes(closed | fan))


def _eroded(fan: BoolArray, pitch_mm: float) -> BoolArray:
    """The fan without its outermost EROSION_MM; where the image's box cuts it off, it stays whole."""
    if fan.all():
        return fan
    return np.asarray(ndimage.distance_transform_edt(fan, sampling=pitch_mm) > EROSION_MM)


def _box(usable: BoolArray) -> tuple[slice, slice, slice]:
    found = ndimage.find_objects(usable.view(np.uint8))[0]
    return found[0], found[1], found[2]


def _wider(box: tuple[slice, slice, slice], grid: Grid, margin_mm: float) -> tuple[slice, slice, slice]:
    """The box with a margin, as far as the image goes."""
    more = np.ceil(margin_mm / grid.spacing_mm).astype(int)
    wide = [
        slice(max(0, s.start - m), min(n, s.stop + m)) for s, m, n in zip(box, more, grid.shape, strict=True)
    ]
    return wide[0], wide[1], wide[2]


def _corners(shape: tuple[int, int, int]) -> FloatArray:
    top = np.array(shape) - 1.0
    return np.vstack([np.zeros(3), np.diag(top), top])


def _text(xyz: AnyArray) -> str:
    return "(" + ", ".join(f"{v:.1f}" for v in xyz) + ")"
