"""From a 4-D image and the labels of its end-diastole to the fixture model: Section III, end to end."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dvf_ig.core import (
    BoolArray,
    Chamber,
    DvfModel,
    FloatArray,
    Grid,
    InvalidInputError,
    Mesh,
    Progress,
    SurfaceSeries,
    Volume,
    VolumeSeries,
    read_only_arrays,
    untold,
)
from dvf_ig.preop.motion.base_descent import BaseDescent, base_descent, propagate_through, unknown_descent
from dvf_ig.preop.motion.cycle import (
    CycleMotion,
    MotionOptions,
    cavity_volumes_mm3,
    propagate_surface,
    track_cycle,
)
from dvf_ig.preop.motion.open_ends import OpenEnd, open_ends, seen_part
from dvf_ig.preop.motion.quality import MotionQuality, assess_motion
from dvf_ig.preop.motion.slice_phases import SlicePhases, retimed, slice_phases
from dvf_ig.preop.motion.slice_shifts import SliceShifts, slice_shifts
from dvf_ig.preop.motion.slice_stack import observable_axes
from dvf_ig.preop.surface.between_slices import between_slices
from dvf_ig.preop.surface.chambers import chamber_of, label_name
from dvf_ig.preop.surface.closing import triangle_areas_mm2
from dvf_ig.preop.surface.from_labels import FINEST_VOXEL_MM, SMOOTHING_VOXELS, border_caps, surface_of_mask
from dvf_ig.preop.surface.walls import missing_walls, with_walls

from .build import ModelOptions, build_model
from .check import away_from_caps
from .components import largest_component
from .tissue import tissue_of_cine

_OFFSETS = np.array([[0.0, 0.0, 0.0], [0.5, 0.25, 0.0], [0.25, 0.5, 0.75], [0.75, 0.0, 0.5]])
"""Positions of the ball's centre relative to the voxels, in voxels."""


@dataclass(frozen=True, slots=True)
class SurfaceBudget:
    """Errors of the conversion from mask to surface, which a perfect mask has as well.

    Attributes:
        radius_mm: of the ball.
        voxel_mm: standard deviation of the surface about the ball, from voxels and triangles.
        shrinkage_mm: shrinkage that the Gaussian alone would cause: σ²/R.
        residual_offset_mm: mean offset left after compensation of the shrinkage; positive outwards.
        chord_mm: depth of the middle of a triangle's edge below the ball.
    """

    radius_mm: float
    voxel_mm: float
    shrinkage_mm: float
    residual_offset_mm: float
    chord_mm: float


def surface_budget(spacing_mm: FloatArray, volume_mm3: float) -> SurfaceBudget:
    """Measure the errors of the conversion from mask to surface on a ball.

    Args:
        spacing_mm: (3,) voxel pitch.
        volume_mm3: of the organ.
    Raises:
        InvalidInputError: an organ smaller than a few voxels.
    """
    radius = float((0.75 * volume_mm3 / np.pi) ** (1.0 / 3.0))
    if not radius > 2.0 * float(spacing_mm.min()):
        raise InvalidInputError(
            f"the organ encloses {volume_mm3:.0f} mm³, a few voxels of {spacing_mm.tolist()} mm; "
            "check the label values"
        )
    half = np.ceil(radius / spacing_mm).astype(int) + 2
    shape = (2 * int(half[0]) + 1, 2 * int(half[1]) + 1, 2 * int(half[2]) + 1)
    grid = Grid.axis_aligned("mr", shape, -half * spacing_mm, spacing_mm)
    centers = grid.centers_mm()
    off, edges = [], []
    for offset in _OFFSETS * spacing_mm:
        mesh = surface_of_mask(np.linalg.norm(centers - offset, axis=-1) < radius, grid)
        off.append(np.linalg.norm(mesh.vertices_mm - offset, axis=1) - radius)
        a, b, _ = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
        edges.append(np.linalg.norm(a - b, axis=1))
    apart = np.concatenate(off)
    edge = float(np.sqrt(np.mean(np.concatenate(edges) ** 2)))
    block = np.maximum(FINEST_VOXEL_MM / spacing_mm, 1.0).astype(np.int64)
    sigma = SMOOTHING_VOXELS * float(np.prod(spacing_mm * block)) ** (1.0 / 3.0)
    return SurfaceBudget(
        radius, float(apart.std()), sigma**2 / radius, float(apart.mean()), edge**2 / (8.0 * radius)
    )


_LOG = logging.getLogger(__name__)

MIN_IMAGED_SHARE = 0.02
"""Smallest share of the surface's area that the image must show (without caps and their rim). Seven slices of
10 mm through a heart show 0.23 to 0.32; with 1 mm in the header by mistake, 0.00 to 0.01."""


@dataclass(frozen=True, slots=True)
class CineOptions:
    """Meaning of the labels, and options of motion and model.

    Attributes:
        organ_labels: values inside the surface; empty means all except 0.
        cavity_labels: values of blood, that of the left ventricle first; empty means that none is labelled.
        ed_phase: the phase that the labels belong to.
        surface: name of the surface.
        label_names: names of label values.
    """

    organ_labels: tuple[int, ...] = ()
    cavity_labels: tuple[int, ...] = ()
    ed_phase: int = 0
    surface: str = "EPICARDIAL"
    motion: MotionOptions = field(default_factory=MotionOptions)
    model: ModelOptions = field(default_factory=ModelOptions)
    label_names: tuple[tuple[int, str], ...] = ()


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CineModel:
    """Model with the evidence behind it.

    Attributes:
        model: the fixture.
        surfaces: the end-diastolic surface propagated through the cycle.
        motion, quality: the motion as the images show it, each slice in its own cycle, and its quality.
        budget: error budget of the end-diastolic surface itself.
        volume_mm3: (n,) of the left ventricle's cavity, or enclosed by the surface if none is labelled.
        open_ends: borders of the image within the organ; beyond them the surface is closed, not measured.
        shifts: of the slices of a stack, which its surfaces are corrected for; None without long-axis views.
        base: how the base moves through the slices of a stack, or that it is not known; None for an image
            without distant slices.
        phases: end-systole of every slice, None likewise; the surfaces are in the phases of their mean.
    """

    model: DvfModel
    surfaces: SurfaceSeries
    motion: CycleMotion
    quality: MotionQuality
    budget: SurfaceBudget
    volume_mm3: FloatArray
    open_ends: tuple[OpenEnd, ...]
    shifts: SliceShifts | None = None
    base: BaseDescent | None = None
    phases: SlicePhases | None = None


def model_from_cine(
    image: VolumeSeries,
    labels: Volume,
    *,
    patient_id: str,
    views: Sequence[VolumeSeries] = (),
    options: CineOptions = CineOptions(),
    truth: VolumeSeries | None = None,
    progress: Progress | None = None,
    sources: Sequence[str] = (),
) -> CineModel:
    """Propagate a segmented end-diastole through the cycle by the image's motion, and fit the model to it.

    The surfaces of the cavities follow the same motion and become the model's chambers.

    Args:
        image: 4-D grey levels.
        labels: labels of phase `options.ed_phase`, on the image's grid.
        views: long-axis cines of one slice each, if the image is a short-axis stack: they correct the shifts
            of its slices, and show the base's descent.
        truth: labels of every phase; used only to assess the motion, never to estimate it.
        progress: called with the fraction done.
    Raises:
        InvalidInputError: no voxel of the organ or cavity labels, labels on another grid, or an image that
            cuts the organ off everywhere; long-axis views of an image that is no stack.
    """
    if views:
        _require_stack(image.grid, views)
    organ = largest_component(_chosen(labels, options.organ_labels, "organ"))
    cavities = [_chosen(labels, (value,), "cavity") for value in options.cavity_labels]
    report = progress or untold
    names = [label_name(value, dict(options.label_names)) for value in options.cavity_labels]
    added, told_walls = missing_walls(organ, cavities, names)
    walled = with_walls(organ, [cavities[k] for k in added], image.grid.spacing_mm)
    for sentence in told_walls:
        _LOG.warning("%s", sentence)
    surface = _surface(walled, image.grid)
    caps = border_caps(surface, image.grid)
    _require_imaged(surface, caps, image.grid)
    ends = open_ends(organ, image.grid)
    blood = np.isin(labels.values, options.cavity_labels) if cavities else None
    motion = track_cycle(
        image,
        organ,
        ed_phase=options.ed_phase,
        blood=blood,
        options=options.motion,
        progress=lambda x: report((0.5 if views else 0.8) * x),
    )
    tracked, shifts, base, phases = motion, None, None, None
    if not observable_axes(image.grid.spacing_mm)[2]:
        phases = slice_phases(motion, image.timing, cavities[0] if cavities else organ)
        motion = retimed(motion, image.timing, phases)
    if phases is not None and views:
        shifts = slice_shifts(image, organ, cavities[0] if cavities else organ, views)
        base = base_descent(
            image,
            organ,
            blood,
            options.ed_phase,
            views,
            shifts,
            phases,
            options.motion,
            progress=lambda x: report(0.5 + 0.3 * x),
        )
    volumes = cavity_volumes_mm3(motion, cavities[0] if cavities else organ)
    if base is None and not observable_axes(image.grid.spacing_mm)[2]:
        base = unknown_descent(image.grid, organ, volumes)
    moving = _Moving(motion, image, shifts, base)
    surfaces = replace(moving.surface(surface, walled, options.surface), patient_id=patient_id)
    if not cavities:
        volumes = surfaces.volumes_mm3()
    labelled = (
        None if truth is None else np.stack([_chosen_values(v, options.organ_labels) for v in truth.values])
    )
    seen = seen_part(image.grid, organ, None if shifts is None else shifts.sax_mm, base)
    if seen is not None:
        middles = surfaces.vertices_mm[options.ed_phase][surface.triangles].mean(axis=1)
        caps = border_caps(surface, image.grid, axes=2) | ~seen.holds(middles, options.ed_phase)
    quality = assess_motion(tracked, image, organ, labelled)
    model = build_model(
        [surfaces.phase(i) for i in range(len(image.timing))],
        [caps] * len(image.timing),
        image.timing,
        patient_id=patient_id,
        surface_name=options.surface,
        frame=image.grid.frame,
        cavity_mm3=volumes,
        options=options.model,
        progress=lambda x: report(0.8 + 0.2 * x),
        sources=(
            *sources,
            *(end.told for end in ends),
            *_stack_sources(image.grid, shifts, base),
            *told_walls,
        ),
        chambers=[
            chamber
            for name, mask in zip(names, cavities, strict=True)
            if (chamber := _chamber(moving, mask, name))
        ],
    )
    tissue = None
    if base is None:
        moves = [deformation.move for deformation in motion.deformations]
        tissue = tissue_of_cine(labels, options.label_names, model.reference, options.ed_phase, moves)
    model = replace(model, cine_fingerprint=image.fingerprint(), seen=seen, tissue=tissue)
    budget = surface_budget(image.grid.spacing_mm, surface.volume_mm3())
    return CineModel(model, surfaces, tracked, quality, budget, volumes, ends, shifts, base, phases)


def _surface(mask: BoolArray, grid: Grid) -> Mesh:
    """Extract the surface of a mask, between the slices of a stack by the depth within them."""
    if observable_axes(grid.spacing_mm)[2]:
        return surface_of_mask(mask, grid)
    return surface_of_mask(*between_slices(mask, grid))


def _require_stack(grid: Grid, views: Sequence[VolumeSeries]) -> None:
    """Raise InvalidInputError where long-axis views do not go with the image."""
    if observable_axes(grid.spacing_mm).all():
        raise InvalidInputError(
            "long-axis views go with a short-axis stack; the 4-D image has no distant slices: leave them out"
        )
    for k, view in enumerate(views):
        if view.grid.shape[2] != 1:
            raise InvalidInputError(
                f"long-axis view {k + 1} has {view.grid.shape[2]} slices; needed a cine of one slice"
            )


@dataclass(frozen=True, slots=True)
class _Moving:
    """Motion of all surfaces of a heart: within slices, through them, and between breath-holds."""

    motion: CycleMotion
    image: VolumeSeries
    shifts: SliceShifts | None
    base: BaseDescent | None

    def surface(self, mesh: Mesh, mask: BoolArray, name: str) -> SurfaceSeries:
        """Propagate what encloses a mask at end-diastole, to where the mean of all breath-holds is."""
        if self.base is None:
            return propagate_surface(self.motion, self.image, mesh, name, "")
        series = propagate_through(self.motion, self.image, mesh, mask, self.base, name)
        if self.shifts is None:
            return series
        return replace(series, vertices_mm=self.shifts.corrected(series.vertices_mm))


def _stack_sources(grid: Grid, shifts: SliceShifts | None, base: BaseDescent | None) -> tuple[str, ...]:
    """What a stack of slices leaves open, or long-axis views have filled in, for the model's sources."""
    if observable_axes(grid.spacing_mm).all():
        return ()
    sentences = []
    if shifts is not None:
        largest = float(np.linalg.norm(shifts.sax_mm, axis=1).max())
        sentences.append(
            f"slices were shifted by up to {largest:.1f} mm between breath-holds, and are corrected"
        )
    if base is not None:
        sentences.append(base.sentence)
    return tuple(sentences)


def _require_imaged(surface: Mesh, caps: BoolArray, grid: Grid) -> None:
    """Raise InvalidInputError if the image cuts off nearly all of the organ, or lost its voxel size."""
    measured = ~caps
    middles = surface.vertices_mm[surface.triangles[measured]].mean(axis=1)
    measured[measured] = away_from_caps(surface, caps, middles)
    area = triangle_areas_mm2(surface.vertices_mm, surface.triangles)
    if area[measured].sum() < MIN_IMAGED_SHARE * area.sum():
        axis = int(np.argmin(np.array(grid.shape) * grid.spacing_mm))
        raise InvalidInputError(
            f"the 4-D image cuts the organ off nearly everywhere: it is {grid.shape[axis]} voxels of "
            f"{grid.spacing_mm[axis]:g} mm thick; give more slices, or check the voxel size in its header "
            "(--voxel-mm gives the right one)"
        )


def _chamber(moving: _Moving, cavity: BoolArray, name: str) -> Chamber | None:
    """Propagate a cavity of end-diastole as the organ's surface.

    None, with a warning, where the outermost slice of a stack shows no more than its end.
    """
    try:
        surface = _surface(cavity, moving.image.grid)
    except InvalidInputError as exc:
        if observable_axes(moving.image.grid.spacing_mm)[2]:
            raise
        _LOG.warning("the slices hold too little of %s for a surface, and it is left out: %s", name, exc)
        return None
    return chamber_of(moving.surface(surface, cavity, name))


def _chosen_values(values: BoolArray, chosen: tuple[int, ...]) -> BoolArray:
    return np.isin(values, chosen) if chosen else np.asarray(values != 0)


def _chosen(labels: Volume, chosen: tuple[int, ...], what: str) -> BoolArray:
    mask = _chosen_values(labels.values, chosen)
    if not mask.any():
        raise InvalidInputError(
            f"the labels have no voxel of the {what} labels {list(chosen) or 'other than 0'}; "
            f"values present are {np.unique(labels.values).tolist()[:20]}"
        )
    return mask
