"""What long-axis cines show beyond the ends of a short-axis stack: thin slabs of grey levels.

A stack ends below the atria, and from the ventricles alone a pose may slide along the heart's axis and turn.
Three long-axis views show atria, valves and apex in their planes: there, half a slice's thickness to either
side, LC2 compares ultrasound with their own grey levels, as it does with isotropic MR.
"""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from dvf_ig.core import BoolArray, FloatArray, Grid, VolumeSeries, nearest_phase, require_same_frame

from .coverage import CoveredPart
from .lc2.channels import ModelChannels

BEYOND_MM = 56.0
"""How far beyond the stack views are compared: atria reach 40 to 50 mm above the mitral plane."""
BESIDE_MM = 5.0
"""How far beyond the covered part's outline along the stack's normal views are compared."""


def with_long_axis_views(
    channels: ModelChannels,
    part: CoveredPart,
    views: Sequence[VolumeSeries],
    shifts_mm: FloatArray,
    *,
    smoothing_mm: float,
) -> tuple[ModelChannels, CoveredPart]:
    """Add long-axis views beyond the ends of a stack to its channels and covered part.

    Args:
        channels, part: of the stack, on one grid whose last axis is the stack's normal.
        views: one slice each.
        shifts_mm: (v, 3) displacement of the heart in each view from where the channels show it.
        smoothing_mm: standard deviation of the Gaussian on the grey levels, within the view's plane.
    Returns:
        channels and covered part on a grid that reaches BEYOND_MM further either way; where ultrasound may
        image the heart's surface remains that of the stack.
    """
    beyond = int(np.ceil(BEYOND_MM / part.grid.spacing_mm[2]))
    stack = slice(beyond, beyond + part.grid.shape[2])
    grid = _lengthened(part.grid, beyond)
    outline = part.compared_voxels.any(axis=2)
    away_mm = ndimage.distance_transform_edt(~outline, sampling=part.grid.spacing_mm[:2])
    wanted = np.repeat((away_mm <= BESIDE_MM)[:, :, None], grid.shape[2], axis=2)
    wanted[:, :, stack] = False
    places_mm = grid.centers_mm()[wanted]
    nearest_mm = np.full(len(places_mm), np.inf)
    found = np.zeros((len(channels.fractions), len(places_mm), 2), dtype=np.float32)
    for view, shift_mm in zip(views, shifts_mm, strict=True):
        require_same_frame(grid.frame, view.grid.frame, "a long-axis view of a short-axis stack")
        _add_view(found, nearest_mm, places_mm + shift_mm, view, channels.fractions, smoothing_mm)
    seen = np.isfinite(nearest_mm)
    values = np.zeros((len(channels.fractions), *grid.shape, 2), dtype=np.float32)
    values[:, :, :, stack] = channels.values
    compared = np.zeros(grid.shape, dtype=np.bool_)
    compared[:, :, stack] = part.compared_voxels
    shown = wanted.copy()
    shown[wanted] = seen
    if seen.any():
        levels = found[:, seen]
        mean, deviation = levels.mean(axis=(0, 1)), np.maximum(levels.std(axis=(0, 1)), 1e-12)
        values[:, shown] = (levels - mean) / deviation
    return (
        ModelChannels(grid, values, channels.fractions),
        CoveredPart(grid, compared | shown, part.surface_mm, views=bool(seen.any())),
    )


def _lengthened(grid: Grid, beyond: int) -> Grid:
    """Grid with more slices before the first and after the last."""
    nx, ny, nz = grid.shape
    origin = grid.to_mm(np.array([0.0, 0.0, -float(beyond)]))
    return Grid(grid.frame, (nx, ny, nz + 2 * beyond), origin, grid.spacing_mm, grid.direction)


def _add_view(
    found: np.ndarray,
    nearest_mm: FloatArray,
    places_mm: FloatArray,
    view: VolumeSeries,
    fractions: FloatArray,
    smoothing_mm: float,
) -> None:
    """Write grey level and gradient of a view to the (n, 3) places that lie in it nearer than in the others.

    Args:
        found: (phases, n, 2); nearest_mm: (n,) distance of the view that is written there.
    """
    grid = view.grid
    index = grid.to_index(places_mm)
    apart_mm = np.abs(index[:, 2]) * float(grid.spacing_mm[2])
    inside = _within_plane(index, grid) & (apart_mm <= 0.5 * float(grid.spacing_mm[2]))
    inside &= apart_mm < nearest_mm
    nearest_mm[inside] = apart_mm[inside]
    pixel_mm = grid.spacing_mm[:2]
    at = index[inside, :2].T
    numbers = nearest_phase(view.timing.fractions, fractions)
    for number in np.unique(numbers):
        smooth = ndimage.gaussian_filter(
            view.values[number, :, :, 0].astype(np.float32), smoothing_mm / pixel_mm
        )
        gradient = np.hypot(*np.gradient(smooth, *pixel_mm.tolist()))
        levels = [ndimage.map_coordinates(image, at, order=1) for image in (smooth, gradient)]
        for phase in np.flatnonzero(numbers == number):
            found[phase, inside] = np.stack(levels, axis=-1)


def _within_plane(index: FloatArray, grid: Grid) -> BoolArray:
    last = np.array(grid.shape[:2]) - 1.0
    return np.asarray(((index[:, :2] >= 0.0) & (index[:, :2] <= last)).all(axis=1))
