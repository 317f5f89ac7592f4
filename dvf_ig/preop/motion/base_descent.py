"""Descent of the heart's base through the planes of a short-axis stack, as long-axis cines show it.

The base comes down by 8 to 16 mm in systole, through slices that stay where they are: a stack alone cannot
see it. A long-axis view shows it in its plane. Its motion is tracked as a stack's is (`track_cycle`); the
motion along the stack's normal, of all that is labelled, is fitted as linear from apex to base.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dvf_ig.core import (
    BoolArray,
    CycleTiming,
    FloatArray,
    Grid,
    Progress,
    VolumeSeries,
    read_only_arrays,
    untold,
)

from .cycle import CycleMotion, MotionOptions, track_cycle
from .open_ends import towards_base
from .slice_shifts import SliceShifts

PHASES = 10
"""Phases at which a long-axis view is tracked."""
USUAL_MM, USUAL_SIGMA_MM = 12.0, 3.0
"""Mitral annular plane systolic excursion of adults, mean and standard deviation."""
COPIES, APART_MM = 3, 20.0
"""A view is tracked as a stack of equal slices, across which no motion is looked for."""
LEAST_PIXELS = 50
"""Labelled pixels of a view that shows the heart."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BaseDescent:
    """Motion of base and apex along the stack's normal.

    Attributes:
        base_mm: (n,) towards the apex, at every phase of the stack; apex_mm: (n,) towards the base.
        sigma_mm: standard deviation of the largest descent.
        views: number of long-axis views that it was seen in.
    """

    base_mm: FloatArray
    apex_mm: FloatArray
    sigma_mm: float
    views: int

    @property
    def largest_mm(self) -> float:
        """The largest descent of the base in the cycle."""
        return float(self.base_mm.max())


def base_descent(
    image: VolumeSeries,
    organ: BoolArray,
    blood: BoolArray | None,
    ed_phase: int,
    views: Sequence[VolumeSeries],
    shifts: SliceShifts,
    options: MotionOptions,
    progress: Progress | None = None,
) -> BaseDescent | None:
    """Measure the base's descent; None if no view shows the labelled heart.

    Args:
        image: the stack; organ: (nx, ny, nz) voxels of the organ in its phase `ed_phase`; blood: of blood, if
            known.
        views: long-axis cines, one slice each.
        shifts: of all slices.
        options: as for the stack's motion.
        progress: called with the fraction done.
    """
    report = progress or untold
    normal = towards_base(image.grid, organ)
    heights = _heights(image.grid, organ, normal)
    fractions = image.timing.fractions
    curves = []
    for v, view in enumerate(views):
        curve = _curve(
            view, image, organ, blood, float(fractions[ed_phase]), shifts, v, normal, heights, options
        )
        if curve is not None:
            curves.append([_cyclic(fractions, *curve, row) for row in (0, 1)])
        report((v + 1) / len(views))
    if not curves:
        return None
    mean = np.mean(curves, axis=0)
    largest = np.array([-base.min() for base, _ in curves])
    spread = float(largest.std(ddof=1)) if len(curves) > 1 else 1.5
    return BaseDescent(-mean[0], mean[1], max(spread, 0.5) / np.sqrt(len(curves)), len(curves))


def _heights(grid: Grid, organ: BoolArray, normal: FloatArray) -> tuple[float, float]:
    """Heights of the lowest and the highest slice that holds the organ."""
    slices = np.flatnonzero(organ.any(axis=(0, 1)))
    ends = [float(grid.to_mm(np.array([0.0, 0.0, float(k)])) @ normal) for k in slices[[0, -1]]]
    return min(ends), max(ends)


def _curve(
    view: VolumeSeries,
    image: VolumeSeries,
    organ: BoolArray,
    blood: BoolArray | None,
    ed_fraction: float,
    shifts: SliceShifts,
    number: int,
    normal: FloatArray,
    heights: tuple[float, float],
    options: MotionOptions,
) -> tuple[FloatArray, FloatArray] | None:
    """(m,) phases and (2, m) motion of base and apex towards the base, in one view."""
    grid = view.grid
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape[:2]), indexing="ij"), axis=-1)
    pixels = np.concatenate([index, np.zeros((*grid.shape[:2], 1))], axis=-1)
    points = grid.to_mm(pixels)
    # a point of the view, moved to where the stack shows it
    heart = points - shifts.views_mm[number]
    stack = heart + (heart - shifts.corrected(heart))
    where = image.grid.to_index(stack)
    shares = [
        ndimage.map_coordinates(mask.astype(np.float64), where.reshape(-1, 3).T, order=1)
        for mask in (organ, blood if blood is not None else organ)
    ]
    inside = np.stack(shares).reshape(2, *grid.shape[:2]) > 0.5
    if int(inside[0].sum()) < LEAST_PIXELS:
        return None
    chosen, fractions = _chosen_phases(view, ed_fraction)
    copies = Grid(
        grid.frame,
        (grid.shape[0], grid.shape[1], COPIES),
        grid.to_mm(np.zeros(3)) - 0.5 * (COPIES - 1) * APART_MM * grid.direction[:, 2],
        np.array([*grid.spacing_mm[:2], APART_MM]),
        grid.direction,
    )
    timing = CycleTiming(fractions - fractions[0], view.timing.rr_s)
    tracked = VolumeSeries(copies, np.repeat(view.values[chosen], COPIES, axis=3), timing)
    mask, cavities = (np.repeat(part[:, :, None], COPIES, axis=2) for part in inside)
    motion = track_cycle(
        tracked, mask, ed_phase=0, blood=None if blood is None else cavities, options=options
    )
    return fractions, _along(motion, points[inside[0]], normal, heights)


def _chosen_phases(view: VolumeSeries, ed_fraction: float) -> tuple[list[int], FloatArray]:
    """Numbers of PHASES phases from end-diastole on, and their fractions, increasing from it."""
    own = view.timing.fractions
    first = int(np.argmin(np.abs((own - ed_fraction + 0.5) % 1.0 - 0.5)))
    steps = np.unique(np.round(np.linspace(0, len(own), PHASES, endpoint=False)).astype(int))
    numbers = [(first + int(step)) % len(own) for step in steps]
    return numbers, own[first] + (own[numbers] - own[first]) % 1.0


def _along(
    motion: CycleMotion, points: FloatArray, normal: FloatArray, heights: tuple[float, float]
) -> FloatArray:
    """(2, m) motion towards the base at both heights, of a line through that of all points."""
    height = points @ normal
    inside = (height > heights[0]) & (height < heights[1])
    line = np.column_stack([np.ones(int(inside.sum())), height[inside]])
    ends = np.array([[1.0, heights[1]], [1.0, heights[0]]])
    out = np.zeros((2, len(motion.deformations)))
    for i, deformation in enumerate(motion.deformations):
        if i == motion.ed_phase:
            continue
        moved = (deformation.move(points[inside]) - points[inside]) @ normal
        out[:, i] = ends @ np.linalg.lstsq(line, moved, rcond=None)[0]
    return out


def _cyclic(at: FloatArray, fractions: FloatArray, values: FloatArray, row: int) -> FloatArray:
    """Interpolate one row of values over the cycle."""
    order = np.argsort(fractions % 1.0)
    return np.asarray(np.interp(at, (fractions % 1.0)[order], values[row][order], period=1.0))
