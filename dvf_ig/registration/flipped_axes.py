"""Coordinates in RAS that were taken for LPS, or the reverse: an error that a flip of the axes takes away.

LPS to RAS turns by 180° about the long axis of the body: no check of rigidity can see it, and a fit to
landmarks absorbs it. What tells is the model, which the marked points lie on, and a pose that was given
besides the landmarks.
"""

import numpy as np

from dvf_ig.core import RAS_FROM_LPS, DvfModel, FloatArray, InvalidInputError, Landmarks, Rigid

POINT_MM = 5.0
"""Median distance of marked points from the model's surfaces that needs no explanation. Points marked with
2 mm of scatter lie 1.5 to 2.4 mm from it, flipped ones of a heart on the flip's axis 6 to 15 mm (hearts 101
to 112)."""
POSE_MM = 20.0
"""The same of landmarks under a coarse start, which is off by 10 mm and 8° as a rule."""
FALLS_TO = 0.5
"""A flip that takes the error to less than this share explains it (docs/theory/safety.md)."""

FLIP = np.diag(RAS_FROM_LPS)[:3].copy()
_REPAIR = "the file holds RAS where it says LPS, or the reverse; write it again"


def require_on_model(marked: Landmarks, model: DvfModel) -> None:
    """Raise InvalidInputError where flipped landmarks lie much nearer the model's surfaces than as given.

    Args:
        marked: on the model at end-diastole, its frame.
    """
    ed = model.ed_phase
    meshes = [model.reference[ed], *(chamber.surfaces[ed] for chamber in model.chambers)]
    surface = np.concatenate([mesh.vertices_mm for mesh in meshes])
    given_mm = _off_mm(marked.points.xyz_mm, surface)
    if given_mm <= POINT_MM:
        return
    flipped_mm = _off_mm(FLIP * marked.points.xyz_mm, surface)
    if flipped_mm < FALLS_TO * given_mm:
        raise InvalidInputError(
            f"the landmarks marked on the model lie {given_mm:.0f} mm from it, and {flipped_mm:.0f} mm with "
            f"x and y reversed: {_REPAIR}"
        )


def require_unflipped(pose: Rigid, marked: Landmarks, touched: Landmarks) -> None:
    """Raise InvalidInputError where landmarks agree with a flipped pose much better than with the given one.

    Args:
        pose: that was given, from the frame of `touched` to that of `marked`.
    """
    _, there, here = marked.paired_with(touched)
    if len(there) < 3:
        return

    def off_mm(before: FloatArray, after: FloatArray) -> float:
        at = after * pose.apply_array(before * here.xyz_mm)
        return float(np.median(np.linalg.norm(at - there.xyz_mm, axis=1)))

    same = np.ones(3)
    given_mm = off_mm(same, same)
    flipped_mm = min(off_mm(FLIP, same), off_mm(same, FLIP), off_mm(FLIP, FLIP))
    if given_mm > POSE_MM and flipped_mm < FALLS_TO * given_mm:
        raise InvalidInputError(
            f"the start pose puts the touched landmarks {given_mm:.0f} mm from where they are marked, and "
            f"{flipped_mm:.0f} mm with x and y reversed: {_REPAIR}"
        )


def _off_mm(points_mm: FloatArray, surface_mm: FloatArray) -> float:
    apart = np.linalg.norm(points_mm[:, None] - surface_mm[None], axis=2)
    return float(np.median(apart.min(axis=1)))
