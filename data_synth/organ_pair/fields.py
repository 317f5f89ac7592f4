"""Smooth random functions of space, from filtered noise on a grid."""

import numpy as np
from scipy import ndimage
from scipy.interpolate import make_interp_spline

from dvf_ig.core import AnyArray, FloatArray, Grid


def smooth_field(grid: Grid, wavelength_mm: float, rng: np.random.Generator) -> FloatArray:
    """Draw a (nx, ny, nz) field of zero mean and unit variance, with structures of about `wavelength_mm`.

    Band-passed noise on a coarse grid of an eighth of a wavelength, interpolated by cubic splines.
    """
    step_mm = wavelength_mm / 8.0
    extent_mm = (np.array(grid.shape) - 1) * grid.spacing_mm
    nodes = np.ceil(extent_mm / step_mm).astype(int) + 4
    noise = rng.normal(size=nodes + 16)
    band = ndimage.gaussian_filter(noise, 1.3) - ndimage.gaussian_filter(noise, 2.6)
    field = band[8:-8, 8:-8, 8:-8]
    for axis in range(3):
        at = np.arange(grid.shape[axis]) * grid.spacing_mm[axis] / step_mm
        weights = make_interp_spline(np.arange(nodes[axis]), np.eye(nodes[axis]), k=3)(at)
        field = np.moveaxis(np.tensordot(weights, field, axes=(1, axis)), 0, axis)
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


def sampled(values: AnyArray, grid: Grid, xyz_mm: FloatArray) -> FloatArray:
    """Interpolate a grid's field linearly at (..., 3) mm; the border value applies outside."""
    at = np.moveaxis(grid.to_index(xyz_mm), -1, 0)
    return np.asarray(ndimage.map_coordinates(values, at, order=1, mode="nearest", output=np.float32))
