"""Signed distance of one phase as an image, for programs that read images but not splines."""

import numpy as np

from dvf_ig.core import DvfModel, Grid, Volume

from .field import SplineField

EDGE_MM = 1e-9
"""Distance within the box at which its border voxels are evaluated, so that rounding puts none outside."""


def distance_volume(model: DvfModel, phase: int) -> Volume:
    """Sample signed distance in mm, float32, positive inside, on every half knot of the model's box.

    Between voxels, linear interpolation differs from the model by the field's curvature alone: h²/(4R) at a
    surface of radius R, 0.03 mm at half a knot h = 1.5 mm and R = 20 mm.

    Args:
        phase: index of the phase.
    """
    knots = np.array(model.coefficients.shape[1:]) - 3
    nx, ny, nz = (2 * knots + 1).tolist()
    grid = Grid.axis_aligned(model.frame, (nx, ny, nz), model.origin_mm, model.knot_spacing_mm / 2)
    inside_mm = np.clip(grid.centers_mm().reshape(-1, 3), model.origin_mm + EDGE_MM, model.upper_mm - EDGE_MM)
    distance_mm, _ = SplineField.of_model(model, phase).at(inside_mm)
    return Volume(grid, distance_mm.reshape(grid.shape).astype(np.float32))
