"""The pre-operative heart: its fixture model, and the channels that ultrasound is compared with."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    BoolArray,
    DvfModel,
    FloatArray,
    Grid,
    InvalidInputError,
    Preop,
    SeenPart,
    VolumeSeries,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.core.progress import thread_pool
from dvf_ig.kernels.compiled import thread_count
from dvf_ig.preop import (
    CHAMBER_SURFACES,
    beyond_stack,
    close_surface,
    model_from_preop,
    observable_axes,
    rasterise,
    rasterise_meshes,
    slice_shifts,
    with_blood_that_enters,
)
from dvf_ig.registration import (
    BLOOD,
    WALL,
    BoundaryTarget,
    CoveredPart,
    ModelChannels,
    channels_from_labels,
    channels_from_mr,
    covered_part,
    ends_within,
    target_from_labels,
)

log = logging.getLogger(__name__)

COARSE_PITCH_MM = 3.0
"""Pixels of the coarse slices."""
FINE_PITCH_MM = 2.0
"""Pixels of the fine slices, and of those on which the boundary is found."""
MR_SMOOTHING_MM = 2.5
"""Standard deviation of the Gaussian on MR: 2.0 makes the TRE 0.14 mm worse on tuning seeds 101–104, 3.0 the
force error 0.013 N."""
LABEL_VOXEL_MM = 2.0
"""Voxels of labels that are made from surfaces."""
LABEL_SMOOTHING_MM = 1.5
"""Standard deviation of the Gaussian on them if they replace grey levels."""
STACK_SMOOTHING_MM = 1.0
"""The same where they stand for a stack of slices: with real stacks 002 and 003, from the true pose, LC2 ends
1.05 and 1.35 mm off with 1.0 mm; 1.41 and 1.61 with 1.5; 1.74 and 2.09 with 2.5; with the stack's own grey
levels, interpolated between slices, 4.9 and 3.9 mm."""
LABEL_MARGIN_MM = 20.0
"""Margin around the surfaces that they are made from."""


_WITHOUT_CHAMBERS = (
    "the model of patient '%s' holds no chamber of blood, whose boundary ultrasound shows best: registration "
    "goes by grey levels or the outer surface alone; build the model again with the label values of blood "
    "(model build --cavity) or with the surface of a ventricle"
)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Heart:
    """The fixture model, and what ultrasound is registered to.

    Attributes:
        model: signed distance per phase.
        channels: by which LC2 explains ultrasound at every pitch.
        center_mm: (3,) centre of the heart box.
        surface: the boundary of blood and wall, which ultrasound shows; None without a cavity.
        beats_update_pose: whether LC2 on these channels is good enough for a single beat to move the pose.
        covered: the part of the heart that the MR covers; None if it holds all of it, or there is none.
    """

    model: DvfModel
    channels: ModelChannels
    center_mm: FloatArray
    surface: BoundaryTarget | None
    beats_update_pose: bool = True
    covered: CoveredPart | None = None


def build_heart(
    preop: Preop, model: DvfModel | None = None, progress: Callable[[float], None] | None = None
) -> Heart:
    """Build model and channels from the pre-operative data of a heart.

    LC2 compares ultrasound with the MR where there is one, else with wall and blood; also where the MR is a
    stack of slices that ends within the heart, as grey levels between slices are not known. These, and the
    boundary between them, come from labels of every phase or surfaces in the pre-operative data, else (and
    for such a stack) from the model's own surfaces. A model without chambers leaves the boundary out, and
    says so as a warning.

    Args:
        model: a model of this patient that was built before; saves building it. With it, `preop` needs to
            hold nothing but the patient's id.
    Raises:
        InvalidInputError: nothing to build a model from, another patient's model, or MR that does not show
            the model's heart.
    """
    if model is None:
        model = model_from_preop(preop, progress=progress)
    model.require_patient(preop.patient_id)
    vertices = model.reference[model.ed_phase].vertices_mm
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    if preop.mr is not None:
        _require_within(preop.mr, model, center)
    labels = _labels_of(preop, model)
    seen = bool((labels.boundary.values == BLOOD).any())
    if not seen:
        log.warning(_WITHOUT_CHAMBERS, model.patient_id)
    with thread_pool(thread_count()) as pool:
        boundary = labels.boundary
        target = pool.submit(target_from_labels, boundary, boundary.timing.fractions) if seen else None
        if preop.mr is not None and labels.by_grey_levels:
            channels = channels_from_mr(preop.mr, smoothing_mm=MR_SMOOTHING_MM)
        else:
            smoothing_mm = LABEL_SMOOTHING_MM if labels.covered is None else STACK_SMOOTHING_MM
            channels = channels_from_labels(labels.compared, smoothing_mm=smoothing_mm)
        surface = target.result() if target is not None else None
    return Heart(model, channels, center, surface, labels.by_grey_levels, labels.covered)


@dataclass(frozen=True, slots=True, eq=False)
class _Labels:
    """Wall and blood of a heart at every phase.

    Attributes:
        boundary: of whose surface the boundary is.
        compared: that LC2 compares where it does not compare grey levels.
        covered: see `Heart`.
        by_grey_levels: whether LC2 compares grey levels of the MR.
    """

    boundary: VolumeSeries
    compared: VolumeSeries
    covered: CoveredPart | None
    by_grey_levels: bool


def _labels_of(preop: Preop, model: DvfModel) -> _Labels:
    mr, vertices = preop.mr, model.reference[model.ed_phase].vertices_mm
    if mr is None or not ends_within(mr.grid, vertices):
        has_anatomy = preop.labels is not None or preop.surfaces
        labels = label_map(preop) if has_anatomy else label_map_of_model(model)
        return _Labels(labels, labels, None, mr is not None)
    labels = label_map_of_model(model, mr.grid)
    shown = _shown(labels, model.seen)
    covered = covered_part(labels, vertices, shown)
    if not _is_stack(mr.grid):
        return _Labels(labels, labels, covered, True)
    if preop.views:
        shifts_mm = _view_shifts_mm(mr, preop.views, labels, model.ed_phase)
        extended = beyond_stack(labels, shown, preop.views, shifts_mm)
        if extended is not None:
            covered = covered.extended(extended.labels, extended.known)
            return _Labels(extended.labels, extended.labels, covered, False)
    return _Labels(labels, with_blood_that_enters(labels, mr), covered, False)


def _shown(labels: VolumeSeries, seen: SeenPart | None) -> BoolArray:
    """(n, nx, ny, nz) voxels at the heights at which slices show the heart, at each phase."""
    if seen is None:
        return np.ones(labels.values.shape, dtype=np.bool_)
    centers_mm = labels.grid.centers_mm()
    return np.stack([seen.holds(centers_mm, phase) for phase in range(len(labels.timing))])


def _view_shifts_mm(
    mr: VolumeSeries, views: Sequence[VolumeSeries], labels: VolumeSeries, ed_phase: int
) -> FloatArray:
    """(v, 3) displacement of the heart in each long-axis view from where the labels have it."""
    index = labels.grid.to_index(mr.grid.centers_mm())
    heart = labels.values[ed_phase][labels.grid.nearest(index)] != 0
    organ = heart & labels.grid.holds(index, margin=1.0)
    return slice_shifts(mr, organ, organ, views).views_mm


def _is_stack(grid: Grid) -> bool:
    """Return whether slices lie so far apart that grey levels between them are not known."""
    return not bool(observable_axes(grid.spacing_mm).all())


def _require_within(mr: VolumeSeries, model: DvfModel, center_mm: FloatArray) -> None:
    """Raise InvalidInputError if MR and model are in different frames or far apart."""
    require_same_frame(model.frame, mr.grid.frame, "the 4-D MR that goes with the model")
    if not mr.grid.holds(mr.grid.to_index(center_mm)):
        raise InvalidInputError(
            f"the centre of the model's heart, {center_mm.round(1).tolist()} mm, lies outside the 4-D MR; "
            "give the MR of the examination that the model was built from"
        )


def label_map(preop: Preop) -> VolumeSeries:
    """Label wall and blood (1, 2) of the heart, from its label image or by rasterising its surfaces."""
    if preop.labels is not None:
        table = np.zeros(256, dtype=np.uint8)
        table[list(preop.organ_labels)] = WALL
        table[list(preop.blood_labels)] = BLOOD
        return VolumeSeries(preop.labels.grid, table[preop.labels.values], preop.labels.timing)
    closed = {s.name: close_surface(s) for s in preop.surfaces}
    guarded = closed[preop.surface]
    return rasterise(closed, _label_grid(guarded.frame, guarded.vertices_mm.reshape(-1, 3)))


def label_map_of_model(model: DvfModel, within: Grid | None = None) -> VolumeSeries:
    """Wall and blood (1, 2) within the surfaces that a model holds; no blood where it has no chambers.

    Args:
        within: grid of images that end within the heart, and beyond whose ends its surfaces are caps that no
            image shows; None: all of the heart.
    """
    vertices = np.concatenate([mesh.vertices_mm for mesh in model.reference])
    chambers = [chamber.surfaces for chamber in model.chambers]
    if model.surface_name in CHAMBER_SURFACES:
        chambers.append(model.reference)
    grid = _label_grid(model.frame, vertices) if within is None else _covered_grid(within, vertices)
    return rasterise_meshes(model.reference, chambers, grid, model.timing)


def _covered_grid(images: Grid, vertices_mm: FloatArray) -> Grid:
    """Voxels along the axes of images, around a surface with a margin as far as they reach."""
    index = images.to_index(vertices_mm)
    margin = LABEL_MARGIN_MM / images.spacing_mm
    low = np.maximum(index.min(axis=0) - margin, 0.0)
    high = np.minimum(index.max(axis=0) + margin, np.array(images.shape) - 1.0)
    nx, ny, nz = (int(n) for n in np.floor((high - low) * images.spacing_mm / LABEL_VOXEL_MM) + 1)
    spacing = np.full(3, LABEL_VOXEL_MM)
    return Grid(images.frame, (nx, ny, nz), images.to_mm(low), spacing, images.direction)


def _label_grid(frame: str, vertices_mm: FloatArray) -> Grid:
    """Return voxels around a surface, with a margin."""
    low, high = vertices_mm.min(axis=0) - LABEL_MARGIN_MM, vertices_mm.max(axis=0) + LABEL_MARGIN_MM
    nx, ny, nz = (int(n) for n in np.ceil((high - low) / LABEL_VOXEL_MM) + 1)
    return Grid.axis_aligned(frame, (nx, ny, nz), low, LABEL_VOXEL_MM)
