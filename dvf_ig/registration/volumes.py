"""Gated 3-D ultrasound prepared for registration: planes of every volume, with place and phase."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import InvalidInputError, TrackedVolume
from dvf_ig.kernels.pool import pool_blocks

from .slices import SliceSet, grey_to_root_amplitude, joined, slices_of_volume


def prepare_volumes(volumes: Sequence[TrackedVolume], *, pitch_mm: float, planes: int) -> SliceSet:
    """Average volumes down to about `pitch_mm` and take planes of each along its three axes.

    Args:
        volumes: of one transducer, at any number of phases; they share one unknown pose.
        pitch_mm: wanted; the nearest whole number of voxels is averaged.
        planes: about this many along each axis.
    Raises:
        InvalidInputError: no volume, or one with unequal voxels, or nothing insonified.
    """
    if not volumes:
        raise InvalidInputError("no ultrasound volume passed the gate; needed at least one")
    return joined([_planes(volume, pitch_mm, planes) for volume in volumes])


def _planes(volume: TrackedVolume, pitch_mm: float, planes: int) -> SliceSet:
    grid = volume.image.grid
    if np.ptp(grid.spacing_mm) > 1e-3 * grid.spacing_mm.max():
        raise InvalidInputError(
            f"the ultrasound volume's voxels are {grid.spacing_mm.tolist()} mm; resample it to equal edges"
        )
    step = max(1, round(pitch_mm / float(grid.spacing_mm[0])))
    small: NDArray[np.float32] = np.empty([n // step for n in grid.shape], dtype=np.float32)
    mask = np.asarray(volume.mask.values != 0, dtype=np.uint8)
    pool_blocks(volume.image.values, mask, grey_to_root_amplitude(), step, small)
    pose = volume.tracker_from_image
    first = grid.to_mm(np.full(3, (step - 1) / 2))
    return slices_of_volume(
        small,
        pose.rotation @ (grid.axes_mm * step),
        pose.apply_array(first),
        every=max(1, max(small.shape) // planes),
        frame=pose.target,
        model_phase=volume.model_phase,
        t_s=volume.t_s,
    )
