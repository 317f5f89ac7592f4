"""Coordinates in the wrong axes (RAS for LPS, or mirrored): found by an error that a flip takes away.

LPS to RAS turns by 180° about the long axis of the body: no check of rigidity can see it, and a fit to
landmarks absorbs it. What tells is the model, which the marked points lie on, and a pose that was given
besides the landmarks.
"""

from itertools import product

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, InvalidInputError, Landmarks, Rigid

POINT_MM = 10.0
"""Median distance of marked points from the model's surfaces that needs no explanation."""
POSE_MM = 20.0
"""The same of landmarks under a coarse start, which is off by 10 mm and 8° as a rule."""
FALLS_TO = 0.5
"""A flip that takes the error to less than this share explains it (docs/theory/safety.md)."""

FLIPS = np.array([signs for signs in product((1.0, -1.0), repeat=3) if min(signs) < 0.0])
"""(7, 3) signs of the axes; (−1, −1, 1) is RAS for LPS."""


def require_on_model(marked: Landmarks, model: DvfModel) -> None:
    """Raise InvalidInputError where flipped landmarks lie much nearer the model's surfaces than as given.

    Args:
        marked: on the model at end-diastole, its frame.
    """
    ed = model.ed_phase
    meshes = [model.reference[ed], *(chamber.surfaces[ed] for chamber in model.chambers)]
    surface = np.concatenate([mesh.vertices_mm for mesh in meshes])
    given = marked.points.xyz_mm
    found = _better(_off_mm(given, surface), [_off_mm(given * signs, surface) for signs in FLIPS], POINT_MM)
    if found is not None:
        raise InvalidInputError(
            f"the landmarks marked on the model lie {_off_mm(given, surface):.0f} mm from it, and "
            f"{_off_mm(given * FLIPS[found], surface):.0f} mm with {_named(found)}: their file holds other "
            "axes than it says; write it again in LPS or RAS, and say which"
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
    given = off_mm(same, same)
    sides = [(same, signs) for signs in FLIPS] + [(signs, same) for signs in FLIPS]
    sides += [(signs, signs) for signs in FLIPS]
    errors = [off_mm(before, after) for before, after in sides]
    found = _better(given, errors, POSE_MM)
    if found is not None:
        raise InvalidInputError(
            f"the start pose puts the touched landmarks {given:.0f} mm from where they are marked, and "
            f"{errors[found]:.0f} mm with {_named(found % len(FLIPS))}: the pose holds other axes than it "
            "says; write it again as an ITK transform (LPS)"
        )


def _off_mm(points_mm: FloatArray, surface_mm: FloatArray) -> float:
    apart = np.linalg.norm(points_mm[:, None] - surface_mm[None], axis=2)
    return float(np.median(apart.min(axis=1)))


def _better(given_mm: float, flipped_mm: list[float], usual_mm: float) -> int | None:
    """The flip that explains an error; None where the error is usual or no flip takes it away."""
    best = int(np.argmin(flipped_mm))
    explained = given_mm > usual_mm and flipped_mm[best] < FALLS_TO * given_mm
    return best if explained else None


def _named(flip: int) -> str:
    axes = " and ".join(axis for axis, sign in zip("xyz", FLIPS[flip], strict=True) if sign < 0.0)
    return f"{axes} reversed"
