"""Check of a model's surface at one instant of the cycle against labels or another surface."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    BoolArray,
    DvfModel,
    FloatArray,
    Grid,
    InvalidInputError,
    Mesh,
    Volume,
    read_only_arrays,
)
from dvf_ig.core.space.frames import require_same_frame
from dvf_ig.preop.components import largest_component
from dvf_ig.preop.distance.triangle_tree import build_triangle_tree
from dvf_ig.preop.motion.quality import dice
from dvf_ig.preop.spline.field import SplineField
from dvf_ig.preop.surface.from_labels import surface_of_mask
from dvf_ig.preop.surface.walls import missing_walls, with_walls

from .check import random_surface_points

SAMPLES_PER_KNOT = 2
"""Samples of the spline along each knot pitch, between which its zero level is interpolated linearly."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LabelCheck:
    """Agreement of a model with labels from which it was not built.

    Attributes:
        fraction: position in the cycle at which the model was evaluated.
        dice: overlap of the voxels whose centre the model's surface encloses with those labelled.
        model_to_labels_mm, labels_to_model_mm: (n,), (m,) distances from random points of one surface to the
            other; points where the label image cuts the organ off are left out.
    """

    fraction: float
    dice: float
    model_to_labels_mm: FloatArray
    labels_to_model_mm: FloatArray

    @property
    def both_mm(self) -> FloatArray:
        """(n + m,) distances of both directions."""
        return np.concatenate([self.model_to_labels_mm, self.labels_to_model_mm])


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCheck:
    """Distances between a model's surface and another one, from random points of both.

    Attributes:
        whole_mm: (n,) of all points; seen_mm: (m,) of those that the slices show, and that are no caps.
    """

    whole_mm: FloatArray
    seen_mm: FloatArray


def check_surface(
    model: DvfModel, phase: int, surface: Mesh, *, points: int = 4000, rng: np.random.Generator
) -> SurfaceCheck:
    """Compare the surface that a model was fitted to at a phase with another one of the same heart.

    Args:
        surface: may be open.
        points: random points on each surface.
    Raises:
        FrameMismatchError: a surface in another frame than the model.
    """
    require_same_frame(model.frame, surface.frame, "a surface that a model is checked with")
    own, every, seen = model.reference[phase], [], []
    for source, target in ((own, surface), (surface, own)):
        at, triangle = random_surface_points(source, points, rng)
        off_mm = build_triangle_tree(target.vertices_mm, target.triangles).distance_mm(at)
        known = np.ones(len(at), dtype=np.bool_) if model.seen is None else model.seen.holds(at, phase)
        if source is own:
            known &= ~model.reference_caps[phase][triangle]
        every.append(off_mm)
        seen.append(off_mm[known])
    return SurfaceCheck(np.concatenate(every), np.concatenate(seen))


def check_labels(
    model: DvfModel,
    labels: Volume,
    fraction: float,
    *,
    organ_labels: Sequence[int] = (),
    cavity_labels: Sequence[int] = (),
    points: int = 4000,
    rng: np.random.Generator,
) -> LabelCheck:
    """Compare the model's surface at `fraction` of the cycle with labels of that phase.

    Between two phases the surface is the zero level of the distance interpolated between theirs (Ren 2008,
    eq. 10). The largest piece of the labels counts, with its holes filled and the walls that they lack added
    (`missing_walls`), smoothed like a model's surface.

    Args:
        organ_labels, cavity_labels: values inside the surface, none means all except 0, and values of blood,
            as the model was built with.
        points: random points on each surface.
    Raises:
        FrameMismatchError: labels in another frame than the model.
        InvalidInputError: no voxel of the organ, labels that do not meet the model's surface, or all of it
            within a voxel of the image's border.
    """
    require_same_frame(model.frame, labels.grid.frame, "labels that a model is checked with")
    mask = _organ(labels, organ_labels, cavity_labels)
    field = _field(model, fraction)
    within = _enclosed(field, labels.grid)
    if not (mask & within).any():
        raise InvalidInputError(
            "the labels and the model's surface have no voxel in common; give labels of the same "
            "examination, in its coordinates"
        )
    of_model, of_labels = _zero_level(field, model.frame), surface_of_mask(mask, labels.grid)
    distances = []
    for source, target in ((of_model, of_labels), (of_labels, of_model)):
        at, _ = random_surface_points(source, points, rng)
        at = at[~_cut_off(at, mask, labels.grid)]
        if len(at) == 0:
            raise InvalidInputError(
                "the label image cuts the organ off everywhere; give labels of more than its border"
            )
        distances.append(build_triangle_tree(target.vertices_mm, target.triangles).distance_mm(at))
    return LabelCheck(fraction % 1.0, dice(mask, within), *distances)


def _organ(labels: Volume, organ_labels: Sequence[int], cavity_labels: Sequence[int]) -> BoolArray:
    chosen = np.isin(labels.values, list(organ_labels)) if organ_labels else labels.values != 0
    if not chosen.any():
        raise InvalidInputError(
            f"the labels have no voxel of the organ labels {list(organ_labels) or 'other than 0'}; values "
            f"present are {np.unique(labels.values).tolist()[:20]}"
        )
    cavities = [labels.values == value for value in cavity_labels]
    added, _ = missing_walls(chosen, cavities, [""] * len(cavities))
    return largest_component(with_walls(chosen, [cavities[k] for k in added], labels.grid.spacing_mm))


def _field(model: DvfModel, fraction: float) -> SplineField:
    """Return signed distance at a position in the cycle."""
    first, second, weight = model.timing.bracket(fraction)
    coefficients = (1.0 - weight) * model.coefficients[first] + weight * model.coefficients[second]
    return SplineField(coefficients[None], model.origin_mm, model.knot_spacing_mm)


def _upper_mm(field: SplineField) -> FloatArray:
    """Compute the (3,) far corner of the spline's box, just inside."""
    knots = np.array(field.coefficients.shape[1:]) - 3
    return np.asarray(field.origin_mm + knots * field.knot_spacing_mm * (1.0 - 1e-9))


def _enclosed(field: SplineField, grid: Grid) -> BoolArray:
    """Flag (nx, ny, nz) voxels whose centre is inside the surface."""
    centers = grid.centers_mm()
    in_box = ((centers >= field.origin_mm) & (centers <= _upper_mm(field))).all(axis=-1)
    out = np.zeros(grid.shape, dtype=np.bool_)
    out[in_box] = field.at(centers[in_box])[0] > 0.0
    return out


def _zero_level(field: SplineField, frame: str) -> Mesh:
    from skimage.measure import marching_cubes

    size_mm = _upper_mm(field) - field.origin_mm
    counts = (np.array(field.coefficients.shape[1:]) - 3) * SAMPLES_PER_KNOT + 1
    axes = [np.linspace(0.0, size, n) for size, n in zip(size_mm, counts, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) + field.origin_mm
    distance = field.at(nodes.reshape(-1, 3))[0].reshape(nodes.shape[:3])
    if not distance.min() < 0.0 < distance.max():
        raise InvalidInputError("the model has no surface at this position in the cycle; build it again")
    vertices, triangles, _, _ = marching_cubes(distance, 0.0, allow_degenerate=False)
    spacing = size_mm / (counts - 1)
    return Mesh(frame, field.origin_mm + vertices * spacing, triangles.astype(np.int64))


def _cut_off(xyz_mm: FloatArray, mask: BoolArray, grid: Grid) -> BoolArray:
    """Flag (n,) points within one voxel of a border that the labels reach, or beyond it: cut, not imaged."""
    index = grid.to_index(xyz_mm)
    out = np.zeros(len(xyz_mm), dtype=np.bool_)
    for axis, count in enumerate(mask.shape):
        layers = np.moveaxis(mask, axis, 0)
        if layers[0].any():
            out |= index[:, axis] < 1.0
        if layers[-1].any():
            out |= index[:, axis] > count - 2.0
    return out
