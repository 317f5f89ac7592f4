"""Gated 3-D ultrasound of the toy heart, and the surface of its blood."""

from functools import cache

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation
from toy_heart import CENTER_MM, toy_mr, toy_pose

from dvf_ig.core import FloatArray, Grid, Rigid, TrackedVolume, Volume, VolumeSeries
from dvf_ig.registration import BoundaryTarget, target_from_labels

TURN = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()


def toy_volume(turn: tuple[float, float, float], seed: int) -> TrackedVolume:
    """A view of the toy heart: blood dark, speckle of 0.3 on 1.5 mm voxels, 60 dB in 255 levels."""
    shape, h = (64, 60, 56), 1.5
    grid = Grid("probe", shape, -TURN @ (h * (np.array(shape) - 1) / 2), np.full(3, h), TURN)
    mr = toy_mr()
    mr_from_probe = Rigid.from_rotation_vector(turn, CENTER_MM + np.array([3.0, -2.0, 1.0]), "mr", "probe")
    index = mr.grid.to_index(mr_from_probe.apply_array(grid.centers_mm()))
    level = ndimage.map_coordinates(mr.values[0], np.moveaxis(index, -1, 0), order=1, mode="nearest")
    speckle = np.clip(1 + 0.3 * np.random.default_rng(seed).normal(size=shape), 0.1, None)
    amplitude = (1.2 - level / 300.0) * speckle / 1.6
    grey = np.clip(np.rint(255 * (1 + 40 / 60 * np.log10(amplitude))), 0, 255).astype(np.uint8)
    mask = Volume(grid, np.ones(shape, dtype=np.uint8))
    return TrackedVolume(Volume(grid, grey), mask, toy_pose().inverse() @ mr_from_probe, 0.0)


@cache
def toy_surface() -> BoundaryTarget:
    mr = toy_mr()
    labels = np.where(mr.values > 200, 2, np.where(mr.values < 130, 1, 0)).astype(np.uint8)
    return target_from_labels(VolumeSeries(mr.grid, labels, mr.timing), np.zeros(1))


def resampled(volume: TrackedVolume, spacing_mm: FloatArray, turn: FloatArray) -> TrackedVolume:
    """The volume on voxels of other edges and axes that cover it, grey levels interpolated."""
    grid = volume.image.grid
    corners = grid.to_mm(
        np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (np.array(grid.shape) - 1.0)
    )
    inside = corners @ turn
    low = inside.min(axis=0)
    shape = np.ceil((inside.max(axis=0) - low) / spacing_mm).astype(int) + 1
    out = Grid(grid.frame, (int(shape[0]), int(shape[1]), int(shape[2])), turn @ low, spacing_mm, turn)
    index = np.moveaxis(grid.to_index(out.centers_mm()), -1, 0)
    grey = ndimage.map_coordinates(volume.image.values.astype(np.float32), index, order=1)
    mask = ndimage.map_coordinates(volume.mask.values, index, order=0)
    return TrackedVolume(
        Volume(out, np.rint(grey).astype(np.uint8)),
        Volume(out, mask),
        volume.tracker_from_image,
        volume.model_phase,
    )
