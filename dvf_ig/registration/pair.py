"""Any rigid pair of 3-D images, the fixed one ultrasound: the same search on planes of the fixed volume."""

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from dvf_ig.core import FloatArray, InvalidInputError, Rigid, Volume

from .channels import channels_from_still
from .rigid import Level, RegistrationOptions, RegistrationResult, register_rigid
from .slices import SliceSet, slices_of_volume

PLANES = 14
"""About this many planes are kept along each axis of the fixed volume."""


def register_pair(
    fixed: Volume,
    moving: Volume,
    start: Rigid,
    *,
    rng: np.random.Generator,
    mask: Volume | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """moving_from_fixed of an ultrasound volume (fixed) and an MR or CT volume (moving).

    Args:
        fixed: ultrasound; zeros count as not insonified.
        moving: anatomy with intensities.
        start: moving_from_fixed to start from.
        mask: on the fixed image's grid, non-zero where it may be used.
    Raises:
        InvalidInputError: an empty image, or a mask on another grid.
    """
    usable = fixed.values != 0
    if mask is not None:
        if mask.values.shape != fixed.values.shape:
            raise InvalidInputError(
                f"the mask has shape {mask.values.shape}, the fixed image {fixed.values.shape}; "
                "resample the mask onto the fixed image's grid"
            )
        usable &= mask.values != 0
    if not usable.any():
        raise InvalidInputError("the fixed image has no non-zero voxel inside its mask")
    longest = float((np.array(fixed.values.shape) * fixed.grid.spacing_mm).max())
    fine_mm = max(1.0, longest / 90.0)
    levels = [
        Level(_planes(fixed, usable, pitch), channels_from_still(moving, smoothing_mm=pitch / 1.5), pitch)
        for pitch in (2.0 * fine_mm, fine_mm)
    ]
    index = np.argwhere(usable).mean(axis=0)
    center = start.apply_array(fixed.grid.to_mm(index))
    options = RegistrationOptions(patch_mm=9.0 * fine_mm)
    return register_rigid(levels[0], levels[1], start, center, rng=rng, options=options, progress=progress)


def _planes(fixed: Volume, usable: FloatArray, pitch_mm: float) -> SliceSet:
    """Planes of the fixed volume resampled to an isotropic pitch, outside marked NaN."""
    zoom = fixed.grid.spacing_mm / pitch_mm
    sigma = np.maximum(0.0, 0.5 / zoom - 0.5)
    inside = usable.astype(np.float32)
    blurred = ndimage.gaussian_filter(np.where(usable, fixed.values, 0).astype(np.float32), sigma)
    weight = ndimage.gaussian_filter(inside, sigma)
    smooth = blurred / np.maximum(weight, 1e-6)
    shape = np.maximum(1, np.floor((np.array(fixed.values.shape) - 1) * zoom).astype(int) + 1)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")) / zoom[:, None, None, None]
    values = ndimage.map_coordinates(smooth, index, order=1, mode="nearest")
    seen = ndimage.map_coordinates(inside, index, order=1, mode="constant")
    scale = float(values[seen > 0.99].std()) or 1.0
    values = np.where(seen > 0.99, values / scale, np.nan)
    axes = fixed.grid.direction * pitch_mm
    every = max(1, int(shape.max()) // PLANES)
    stack = values.astype(np.float32)
    return slices_of_volume(stack, axes, fixed.grid.origin_mm, every=every, frame=fixed.grid.frame)
