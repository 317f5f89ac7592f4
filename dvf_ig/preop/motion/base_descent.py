"""Descent of the heart's base through the planes of a short-axis stack, as long-axis cines show it.

The base comes down by 8 to 16 mm in systole, through slices that stay where they are: a stack alone cannot
see it. A long-axis view shows it in its plane. Its motion is tracked as a stack's is (`track_cycle`); that of
what is labelled next to the basal slice, along the stack's normal, is the base's. It is taken to fall
linearly to zero at the apex, which stays: between them the wall slides along its own outline, which shows no
motion. Without such a view the surface stays where the slices show it, uncertain by the descent of adults.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from dvf_ig.core import (
    BoolArray,
    CycleTiming,
    FloatArray,
    Grid,
    Mesh,
    Progress,
    SurfaceSeries,
    VolumeSeries,
    read_only_arrays,
    untold,
)
from dvf_ig.preop.surface.between_slices import depth_within_slices

from .cycle import CycleMotion, MotionOptions, track_cycle
from .slice_phases import SlicePhases, own_fraction
from .slice_shifts import SliceShifts

PHASES = 10
"""Phases at which a long-axis view is tracked."""
USUAL_MM, USUAL_SIGMA_MM = 12.0, 3.0
"""Mitral annular plane systolic excursion of adults, mean and standard deviation."""
PIXEL_MM, APART_MM = 2.4, 20.0
"""Least pixel of a view that is tracked: a line through its motion needs no finer one. Its slice counts
as 20 mm thick, so that no motion is looked for across it."""
LEAST_PIXELS, LEAST_BASAL_PIXELS = 50, 10
"""Labelled pixels of a view that shows the heart, and of one that shows its base."""
BLURS_MM = (3.0, 1.0)
"""Blurs of a view, coarse to fine: between two of its phases the base moves by up to 5 mm."""
BASAL_SHARE = 0.875
"""Share of the way from the apical to the basal slice from which on tissue shows the base's motion."""
OUTLINE_STEPS, LONGEST_MM = 2, 8.0
"""Newton steps onto the outline of another slice, and the longest of them."""
WALL_MM, CAP_MM = 2.0, 6.0
"""Depth within an outline up to which a vertex follows it, and from which it is of a cap and does not."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BaseDescent:
    """Motion of the base along the stack's normal.

    Attributes:
        base_mm: (n,) towards the apex, at every phase of the stack.
        ends_mm: (2,) heights along the normal of the apical slice, which stays, and of the basal one.
        sigma_by_phase_mm: (n,) standard deviation of the base's place along the normal.
        views: number of long-axis views that it was seen in; 0 if it is not known.
    """

    base_mm: FloatArray
    ends_mm: FloatArray
    sigma_by_phase_mm: FloatArray
    views: int

    @property
    def largest_mm(self) -> float:
        """The largest descent of the base in the cycle."""
        return float(self.base_mm.max())

    @property
    def sentence(self) -> str:
        """The descent and where it is known from, as a user reads it."""
        if self.views:
            size = f"{self.largest_mm:.1f} ± {self.sigma_mm:.1f} mm"
            return f"the base descends by {size} through the slices, as {self.views} long-axis views show"
        return (
            "no long-axis view shows the base: its descent through the slices is not known, and the surface "
            f"is uncertain there by that of adults, {USUAL_MM:.0f} ± {USUAL_SIGMA_MM:.0f} mm; give long-axis "
            "cines (--lax, --dicom)"
        )

    @property
    def sigma_mm(self) -> float:
        """The largest standard deviation in the cycle."""
        return float(self.sigma_by_phase_mm.max())

    def shift_mm(self, height_mm: FloatArray, phase: int) -> FloatArray:
        """Motion towards the base of tissue that is at a height at end-diastole."""
        low, high = self.ends_mm
        share = np.clip((height_mm - low) / (high - low), 0.0, 1.0)
        return np.asarray(-share * self.base_mm[phase])


def base_descent(
    image: VolumeSeries,
    organ: BoolArray,
    blood: BoolArray | None,
    ed_phase: int,
    views: Sequence[VolumeSeries],
    shifts: SliceShifts,
    phases: SlicePhases,
    options: MotionOptions,
    progress: Progress | None = None,
) -> BaseDescent | None:
    """Measure the base's descent; None if no view shows the labelled heart.

    Args:
        image: the stack; organ: (nx, ny, nz) voxels of the organ in its phase `ed_phase`; blood: of blood, if
            known.
        views: long-axis cines, one slice each.
        shifts: of all slices; phases: of the stack's, whose course that of the base follows.
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
            curves.append(_in_common(*curve, fractions, ed_phase, phases))
        report((v + 1) / len(views))
    if not curves:
        return None
    mean = np.mean(curves, axis=0)
    largest = np.array([curve.max() for curve in curves])
    spread = float(largest.std(ddof=1)) if len(curves) > 1 else 1.5
    sigma_mm = max(spread, 0.5) / np.sqrt(len(curves))
    course = np.abs(mean) / max(float(np.abs(mean).max()), 1e-9)
    return BaseDescent(mean, np.array(heights), sigma_mm * course, len(curves))


def unknown_descent(grid: Grid, organ: BoolArray, volume_mm3: FloatArray) -> BaseDescent:
    """A base whose descent is not known: still, and uncertain by the descent of adults.

    Args:
        grid, organ: of the stack at end-diastole.
        volume_mm3: (n,) of a cavity or of the organ in every phase; the base follows it.
    """
    most, least = float(volume_mm3.max()), float(volume_mm3.min())
    share = (most - volume_mm3) / max(most - least, 1e-9)
    ends = np.array(_heights(grid, organ, towards_base(grid, organ)))
    size_mm = float(np.hypot(USUAL_MM, USUAL_SIGMA_MM))
    return BaseDescent(np.zeros(len(share)), ends, size_mm * share, 0)


def propagate_through(
    motion: CycleMotion, image: VolumeSeries, surface: Mesh, mask: BoolArray, descent: BaseDescent, name: str
) -> SurfaceSeries:
    """Propagate an end-diastolic surface through the slices and within them.

    The motion that a stack shows is that of outlines in planes that stay, not of tissue. A vertex goes along
    the normal with the base's descent, stays as deep within the outline of the slice where it arrives as it
    was in that where it began, and moves in that slice's plane as its outline does.

    Args:
        image: the stack; mask: (nx, ny, nz) of what the surface encloses at end-diastole.
    """
    grid, normal = image.grid, towards_base(image.grid, mask)
    sign = float(np.sign(normal @ grid.direction[:, 2]))
    depth, slices = depth_within_slices(mask, grid)
    slopes = [np.gradient(depth, float(step), axis=a) for a, step in enumerate(grid.spacing_mm[:2])]
    index, height = grid.to_index(surface.vertices_mm), surface.vertices_mm @ normal

    def at(values: FloatArray, places: FloatArray) -> FloatArray:
        along = np.interp(places[:, 2], slices, np.arange(len(slices)))
        where = np.stack([places[:, 0], places[:, 1], along])
        return np.asarray(ndimage.map_coordinates(values, where, order=1, mode="nearest"))

    began, moved = at(depth, index), []
    follows = np.clip((CAP_MM - np.abs(began)) / (CAP_MM - WALL_MM), 0.0, 1.0)
    for phase, deformation in enumerate(motion.deformations):
        if phase == motion.ed_phase:
            moved.append(surface.vertices_mm)
            continue
        places = index.copy()
        places[:, 2] += sign * descent.shift_mm(height, phase) / grid.spacing_mm[2]
        for _ in range(OUTLINE_STEPS):
            slope = np.stack([at(one, places) for one in slopes], axis=1)
            off = follows * (began - at(depth, places)) / np.maximum((slope**2).sum(axis=1), 0.25)
            places[:, :2] += np.clip(off, -LONGEST_MM, LONGEST_MM)[:, None] * slope / grid.spacing_mm[:2]
        moved.append(deformation.move(grid.to_mm(places)))
    return SurfaceSeries(name, surface.frame, np.stack(moved), surface.triangles, image.timing, "")


def towards_base(grid: Grid, organ: BoolArray) -> FloatArray:
    """(3,) unit normal of a stack towards the end where the organ is larger."""
    area = organ.sum(axis=(0, 1))
    half = len(area) // 2
    sign = 1.0 if area[-half:].sum() > area[:half].sum() else -1.0
    return np.asarray(sign * grid.direction[:, 2])


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
    """(m,) phases and (m,) descent of the base in one view; None if it does not show the base."""
    view = _coarser(view)
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
    share = (points @ normal - heights[0]) / (heights[1] - heights[0])
    basal = inside[0] & (share > BASAL_SHARE) & (share < 1.0)
    if int(inside[0].sum()) < LEAST_PIXELS or int(basal.sum()) < LEAST_BASAL_PIXELS:
        return None
    chosen, fractions = _chosen_phases(view, ed_fraction)
    timing = CycleTiming(fractions - fractions[0], view.timing.rr_s)
    tracked = VolumeSeries(grid, view.values[chosen], timing)
    mask, cavities = inside[..., None]
    wider = replace(options, free_form=replace(options.free_form, blurs_mm=BLURS_MM))
    motion = track_cycle(tracked, mask, ed_phase=0, blood=None if blood is None else cavities, options=wider)
    at_base = points[basal]
    moved = [deformation.move(at_base) - at_base for deformation in motion.deformations]
    return fractions, -np.stack(moved).mean(axis=1) @ normal / share[basal].mean()


def _coarser(view: VolumeSeries) -> VolumeSeries:
    """Average the pixels of a view in blocks of PIXEL_MM or more; its slice becomes APART_MM thick."""
    grid = view.grid
    a, b = (max(1, int(np.ceil(PIXEL_MM / step))) for step in grid.spacing_mm[:2])
    nx, ny = grid.shape[0] // a, grid.shape[1] // b
    blocks = view.values[:, : nx * a, : ny * b].reshape(len(view.timing), nx, a, ny, b, 1)
    origin = grid.to_mm(np.array([0.5 * (a - 1), 0.5 * (b - 1), 0.0]))
    spacing = np.array([a * grid.spacing_mm[0], b * grid.spacing_mm[1], APART_MM])
    coarse = Grid(grid.frame, (nx, ny, 1), origin, spacing, grid.direction)
    return VolumeSeries(coarse, blocks.mean(axis=(2, 4)), view.timing)


def _chosen_phases(view: VolumeSeries, ed_fraction: float) -> tuple[list[int], FloatArray]:
    """Numbers of PHASES phases from end-diastole on, and their fractions, increasing from it."""
    own = view.timing.fractions
    first = int(np.argmin(np.abs((own - ed_fraction + 0.5) % 1.0 - 0.5)))
    steps = np.unique(np.round(np.linspace(0, len(own), PHASES, endpoint=False)).astype(int))
    numbers = [(first + int(step)) % len(own) for step in steps]
    return numbers, own[first] + (own[numbers] - own[first]) % 1.0


def _in_common(
    own: FloatArray, values: FloatArray, fractions: FloatArray, ed_phase: int, phases: SlicePhases
) -> FloatArray:
    """(n,) curve of a view, known from end-diastole on in its own cycle, at the phases of the stack."""
    since = own - own[0]
    es = phases.es_of(np.interp(phases.since_ed, since, values, period=1.0))
    at = own_fraction((fractions - fractions[ed_phase]) % 1.0, es, phases.common_es)
    return np.interp(at, since, values, period=1.0)
