"""Poses from which touched points are fitted: about a coarse one, or spread over all rotations."""

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration.pose_chart import PoseChart, random_displacements

from .touched import TouchedPoints

AROUND, AROUND_MM = 24, 20.0
"""Displaced copies of a coarse start, and how far they are displaced at the heart's radius."""


def starts_about(start: Rigid, center_mm: FloatArray, rng: np.random.Generator) -> list[Rigid]:
    """The start itself, then displaced copies of it."""
    chart = PoseChart(start, np.asarray(center_mm))
    return [start, *(chart.pose(xi) for xi in random_displacements(rng, AROUND, AROUND_MM))]


def starts_everywhere(touched: TouchedPoints, surface_mm: FloatArray, frame: str) -> list[Rigid]:
    """The 60 rotations of the icosahedron, none more than 45° from every one; centroids aligned.

    Args:
        surface_mm: (m, 3) points spread over the model's surface.
        frame: of the model.
    """
    middle, target = touched.points.xyz_mm.mean(axis=0), surface_mm.mean(axis=0)
    turns = Rotation.create_group("I").as_matrix()
    return [Rigid(frame, touched.points.frame, turn, target - turn @ middle) for turn in turns]
