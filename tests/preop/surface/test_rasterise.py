"""Label maps from nested surfaces."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import CycleTiming, FrameMismatchError, Grid, InvalidInputError, SurfaceSeries
from dvf_ig.preop import rasterise


def nested(sphere_of, timing=None):
    timing = timing or CycleTiming.uniform(2, 0.8)
    out = {}
    for name, radius, center in (
        ("EPICARDIAL", 20.0, (0, 0, 0)),
        ("LV_ENDOCARDIAL", 7.0, (9, 0, 0)),
        ("RV_ENDOCARDIAL", 6.0, (-9, 0, 0)),
    ):
        vertices, triangles = sphere_of(radius, 4, center)
        stack = np.stack([vertices, 0.8 * vertices])
        out[name] = SurfaceSeries(name, "mr", stack, triangles, timing, "ball")
    return out


def test_labels_lie_where_the_surfaces_say(sphere_of):
    turned = Rotation.from_rotvec([0.2, 0.4, -0.3]).as_matrix()
    grid = Grid("mr", (30, 30, 30), turned @ np.full(3, -29.0), np.full(3, 2.0), turned)
    reported: list[float] = []
    labels = rasterise(nested(sphere_of), grid, progress=reported.append)
    assert labels.values.dtype == np.uint8
    assert reported == [0.5, 1.0]
    for phase, scale in enumerate((1.0, 0.8)):
        q = grid.centers_mm()

        def inside(radius, center, scale=scale, q=q):
            return scale * radius - np.linalg.norm(q - scale * np.array(center), axis=-1)

        outer, left, right = inside(20, (0, 0, 0)), inside(7, (9, 0, 0)), inside(6, (-9, 0, 0))
        sure = np.minimum(np.minimum(np.abs(outer), np.abs(left)), np.abs(right)) > 0.1
        expected = np.where(outer > 0, 1, 0)
        expected[(left > 0) | (right > 0)] = 2
        assert np.array_equal(labels.values[phase][sure], expected[sure])


def test_refusals(sphere_of):
    grid = Grid.axis_aligned("mr", (8, 8, 8), [0.0] * 3, 2.0)
    surfaces = nested(sphere_of)
    with pytest.raises(InvalidInputError, match="needed EPICARDIAL"):
        rasterise({"LV_ENDOCARDIAL": surfaces["LV_ENDOCARDIAL"]}, grid)
    late = nested(sphere_of, CycleTiming(np.array([0.1, 0.5]), 0.8))
    with pytest.raises(InvalidInputError, match="different phase times"):
        rasterise({**surfaces, "RV_ENDOCARDIAL": late["RV_ENDOCARDIAL"]}, grid)
    with pytest.raises(FrameMismatchError):
        rasterise(surfaces, Grid.axis_aligned("ct", (8, 8, 8), [0.0] * 3, 2.0))
