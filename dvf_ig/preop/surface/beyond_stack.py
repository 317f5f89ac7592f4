"""Blood and outline of the heart beyond the ends of a short-axis stack, from its long-axis views.

A stack ends below the atria, and from the ventricles alone a pose may slide along the heart's axis and turn.
Long-axis views show atria and great vessels in their planes. Blood is bright there: its level and that of the
wall are those of the ventricles, which the stack's labels place in the view. Between the views the depth
within their outlines is interpolated, weighted by nearness (shape-based interpolation, Raya and Udupa 1990).
Near a view that is an image; far from all it is a guess, and not known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    Grid,
    VolumeSeries,
    nearest_phase,
    read_only_arrays,
    require_same_frame,
)

from .rasterise import BLOOD, WALL
from .slice_blood import signed_depth_mm

BEYOND_MM = 56.0
"""How far beyond the stack views are looked at: atria reach 40 to 50 mm above the mitral plane."""
ASIDE_MM = 10.0
"""How far outside the heart's outline, seen along the stack's normal, they are."""
KNOWN_MM = 4.0
"""Distance from a view's plane up to which the heart is known: half the usual thickness of a slice."""
LEVEL = 0.5
"""Blood is what is brighter than this share of the way from wall to blood."""
SMOOTHING_PIXELS = 0.7
"""Standard deviation of the Gaussian on a view."""
LEAST_DEPTH_MM = 4.0
"""Chambers and great vessels are at least twice as wide; fat beside them is thinner."""
WALL_MM = 2.5
"""Thickness of the walls of atria and great vessels."""
NEARNESS_POWER, LEAST_APART_MM = 4.0, 0.5
"""Weight of a view is the inverse of this power of the distance from its plane, of no less than that."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ExtendedLabels:
    """Labels of a stack and beyond its ends.

    Attributes:
        labels: 0 outside, 1 wall, 2 blood.
        known: (nx, ny, nz) voxels that the stack or a view shows.
    """

    labels: VolumeSeries
    known: BoolArray


def beyond_stack(
    labels: VolumeSeries, shown: BoolArray, views: Sequence[VolumeSeries], shifts_mm: FloatArray
) -> ExtendedLabels | None:
    """Extend the labels of a stack by what its long-axis views show beyond it.

    A view that does not show blood and wall within the stack adds nothing; None if no view does.

    Args:
        labels: 0 outside, 1 wall, 2 blood, on a grid whose last axis is the stack's normal.
        shown: (n, nx, ny, nz) voxels in which they are known, at each phase: what follows the base into the
            stack in systole is not labelled.
        views: one slice each.
        shifts_mm: (v, 3) displacement of the heart in each view from where the labels have it.
    """
    stack = labels.grid
    beyond = int(np.ceil(BEYOND_MM / stack.spacing_mm[2]))
    inner = slice(beyond, beyond + stack.shape[2])
    grid = _lengthened(stack, beyond)
    beside = _beside_outline(labels)
    sought = np.repeat(beside[:, :, None], grid.shape[2], axis=2)
    sought[:, :, inner] &= ~shown.all(axis=0)
    places_mm = grid.centers_mm()[sought]
    depth_mm = np.zeros((len(labels.timing), len(places_mm)), dtype=np.float32)
    weights = np.zeros(len(places_mm), dtype=np.float32)
    nearest_mm = np.full(len(places_mm), np.inf)
    for view, shift_mm in zip(views, shifts_mm, strict=True):
        require_same_frame(stack.frame, view.grid.frame, "a long-axis view of a short-axis stack")
        depths = _depths_in_view(labels, shown, view, shift_mm, beside)
        if depths is None:
            continue
        index = view.grid.to_index(places_mm + shift_mm)
        apart_mm = np.abs(index[:, 2]) * float(view.grid.spacing_mm[2])
        last = np.array(view.grid.shape[:2]) - 1.0
        inside = ((index[:, :2] >= 0.0) & (index[:, :2] <= last)).all(axis=1)
        weight = inside * np.maximum(apart_mm, LEAST_APART_MM) ** -NEARNESS_POWER
        for i, depth in enumerate(depths):
            depth_mm[i] += weight * ndimage.map_coordinates(depth, index[:, :2].T, order=1, mode="nearest")
        weights += weight
        nearest_mm = np.where(inside, np.minimum(nearest_mm, apart_mm), nearest_mm)
    if not (nearest_mm <= KNOWN_MM).any():
        return None
    depth_mm = np.where(weights > 0, depth_mm / np.maximum(weights, 1e-12), -np.inf)
    values = np.zeros((len(labels.timing), *grid.shape), dtype=np.uint8)
    values[:, sought] = np.where(depth_mm > 0.0, BLOOD, np.where(depth_mm > -WALL_MM, WALL, 0))
    values[:, :, :, inner] = np.where(shown, labels.values, values[:, :, :, inner])
    known = np.zeros(grid.shape, dtype=np.bool_)
    known[:, :, inner] = shown.all(axis=0)
    known[sought] = nearest_mm <= KNOWN_MM
    return ExtendedLabels(VolumeSeries(grid, values, labels.timing), known)


def _lengthened(grid: Grid, beyond: int) -> Grid:
    """Grid with more slices before the first and after the last."""
    nx, ny, nz = grid.shape
    origin = grid.to_mm(np.array([0.0, 0.0, -float(beyond)]))
    return Grid(grid.frame, (nx, ny, nz + 2 * beyond), origin, grid.spacing_mm, grid.direction)


def _beside_outline(labels: VolumeSeries) -> BoolArray:
    """(nx, ny) within ASIDE_MM of the heart's outline, seen along the stack's normal."""
    outline = (labels.values != 0).any(axis=(0, 3))
    away_mm = ndimage.distance_transform_edt(~outline, sampling=labels.grid.spacing_mm[:2])
    return np.asarray(away_mm <= ASIDE_MM)


def _depths_in_view(
    labels: VolumeSeries, shown: BoolArray, view: VolumeSeries, shift_mm: FloatArray, beside: BoolArray
) -> list[FloatArray] | None:
    """Signed depth within the blood of a view at every phase of the labels; None without blood and wall."""
    index = labels.grid.to_index(view.grid.centers_mm()[:, :, 0] - shift_mm)
    at = labels.grid.nearest(index)
    in_stack = labels.grid.holds(index, margin=0.5) & shown[:, *at]
    looked_at = beside[at[:2]]
    looked_at &= ((index[..., :2] > -0.5) & (index[..., :2] < np.array(beside.shape) - 0.5)).all(axis=-1)
    codes = labels.values[:, *at] * in_stack
    numbers = nearest_phase(view.timing.fractions, labels.timing.fractions)
    levels = _smooth(view, int(numbers[0]))
    if not (codes[0] == BLOOD).any() or not (codes[0] == WALL).any():
        return None
    blood, wall = (float(np.median(levels[codes[0] == code])) for code in (BLOOD, WALL))
    threshold = wall + LEVEL * (blood - wall)
    depths = []
    for i, number in enumerate(numbers.tolist()):
        bright = (_smooth(view, number) > threshold) & looked_at & ~in_stack[i]
        depths.append(_depth_mm(codes[i] == BLOOD, bright, view.grid.spacing_mm[:2]))
    return depths


def _smooth(view: VolumeSeries, phase: int) -> FloatArray:
    return np.asarray(
        ndimage.gaussian_filter(view.values[phase, :, :, 0].astype(np.float64), SMOOTHING_PIXELS)
    )


def _depth_mm(ventricles: BoolArray, bright: BoolArray, pixel_mm: FloatArray) -> FloatArray:
    """Signed distance to the outline of blood, positive inside, without what is thin."""
    both = ndimage.binary_opening(ventricles | bright) | ventricles
    numbers, count = ndimage.label(both)
    inside_mm = ndimage.distance_transform_edt(both, sampling=pixel_mm)
    deepest = ndimage.maximum(inside_mm, numbers, np.arange(1, count + 1)) if count else np.zeros(0)
    deep = np.isin(numbers, 1 + np.flatnonzero(np.asarray(deepest) >= LEAST_DEPTH_MM))
    return signed_depth_mm(deep, pixel_mm)
