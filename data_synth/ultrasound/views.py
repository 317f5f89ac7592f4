"""Standard views of a heart, found from its tissue map alone."""

import numpy as np

from data_synth.heart.reference import ReferenceMap
from data_synth.heart.tissue import Tissue
from dvf_ig.core import FloatArray, InvalidInputError, Rigid

COUPLING_MM = 5.0
"""Thickness of gel or fluid between the transducer's face and the tissue."""

VIEWS = ("apical four-chamber", "tee four-chamber", "epicardial short-axis", "ice atria")

VIEW_PROBE = {
    "apical four-chamber": "apical",
    "tee four-chamber": "tee",
    "epicardial short-axis": "epicardial",
    "ice atria": "ice",
}
"""Usual probe of each view."""


def standard_view(name: str, reference: ReferenceMap) -> Rigid:
    """Find mr_from_plane of a view at end-diastole; columns grow towards the patient's left if possible.

    apical four-chamber: from the left ventricle's apex to the atria, through the right ventricle.
    tee four-chamber: the same plane from behind the left atrium.
    epicardial short-axis: across the left ventricle, from in front of the heart.
    ice atria: from within the right atrium to the left one.

    Raises:
        InvalidInputError: unknown view, or a map without the chambers it needs.
    """
    if name not in VIEWS:
        raise InvalidInputError(f"there is no view '{name}'; choose from {', '.join(VIEWS)}")
    left, atrium = _center(reference, Tissue.LV_BLOOD), _center(reference, Tissue.LA_BLOOD)
    axis = _unit(atrium - left)
    if name == "ice atria":
        right = _center(reference, Tissue.RA_BLOOD)
        return _looking(right, atrium - right, axis)
    if name == "epicardial short-axis":
        anterior = np.array([0.0, -1.0, 0.0])
        depth = -_unit(anterior - (anterior @ axis) * axis)
        return _looking(_outside(reference, left, -depth), depth, np.cross(axis, depth))
    right = _center(reference, Tissue.RV_BLOOD)
    if name == "apical four-chamber":
        return _looking(_outside(reference, left, -axis), axis, left - right)
    return _looking(_outside(reference, atrium, axis), -axis, left - right)


def view_from(eye_mm: FloatArray, towards_mm: FloatArray, roll_rad: float = 0.0) -> Rigid:
    """Build mr_from_plane of a probe at a point, looking at another.

    Without roll, image columns grow towards the patient's left (or head, if the probe looks sideways).

    Raises:
        InvalidInputError: the points coincide.
    """
    depth = np.asarray(towards_mm, dtype=np.float64) - eye_mm
    if np.linalg.norm(depth) < 1e-3:
        raise InvalidInputError(
            "the probe's position and the point it looks at coincide; choose two different points"
        )
    sideways = np.array([1.0, 0.0, 0.0])
    if abs(_unit(depth) @ sideways) > 0.95:
        sideways = np.array([0.0, 0.0, 1.0])
    upright = _looking(np.asarray(eye_mm, dtype=np.float64), depth, sideways)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    roll = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return Rigid("mr", "plane", upright.rotation @ roll, upright.translation_mm)


def _looking(origin_mm: FloatArray, depth: FloatArray, lateral: FloatArray) -> Rigid:
    y = _unit(depth)
    x = _unit(lateral - (lateral @ y) * y)
    return Rigid("mr", "plane", np.column_stack([x, y, np.cross(x, y)]), origin_mm)


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v))


def _center(reference: ReferenceMap, chamber: Tissue) -> FloatArray:
    """Compute the centroid of a chamber's blood."""
    nodes = np.argwhere((reference.inner == chamber) & (reference.organ_mm > 0))
    if not len(nodes):
        raise InvalidInputError(
            f"the tissue map holds no {chamber.name.lower()}; give the probe's position instead of a view"
        )
    return np.asarray(reference.origin_mm + reference.spacing_mm * nodes.mean(axis=0))


def _outside(reference: ReferenceMap, start_mm: FloatArray, direction: FloatArray) -> FloatArray:
    """Find the first point along a ray that is outside the heart for good, and go past the coupling layer."""
    steps_mm = np.arange(0.0, 200.0, 0.5)
    points = start_mm + steps_mm[:, None] * direction
    shape = np.array(reference.organ_mm.shape)
    index = np.rint((points - reference.origin_mm) / reference.spacing_mm).astype(int)
    in_map = ((index >= 0) & (index < shape)).all(axis=1)
    index = np.clip(index, 0, shape - 1)
    inside = in_map & (reference.organ_mm[tuple(index.T)] > 0)
    last = int(np.flatnonzero(inside)[-1]) if inside.any() else 0
    return np.asarray(points[last] + COUPLING_MM * direction)
