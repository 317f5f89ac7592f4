"""Label images from closed surfaces, for registration of surface-only models."""

from collections.abc import Callable, Mapping

import numpy as np

from dvf_ig.core import BoolArray, Grid, InvalidInputError, SurfaceSeries, VolumeSeries
from dvf_ig.core.frames import require_same_frame
from dvf_ig.preop.distance.signed import inside_mask

from .closing import close_surface

BACKGROUND, WALL, BLOOD = 0, 1, 2
OUTER = "EPICARDIAL"
CAVITIES = ("LV_ENDOCARDIAL", "RV_ENDOCARDIAL")


def rasterise(
    surfaces: Mapping[str, SurfaceSeries],
    grid: Grid,
    *,
    progress: Callable[[float], None] | None = None,
) -> VolumeSeries:
    """uint8 labels at the voxel centres: 0 background, 1 wall, 2 blood.

    Blood is what lies inside LV_ENDOCARDIAL or RV_ENDOCARDIAL, wall what is left inside EPICARDIAL. Openings
    are capped first.

    Raises:
        InvalidInputError: EPICARDIAL or both cavities missing, timings that differ, or a surface that cannot
            be closed.
        FrameMismatchError: a surface in another frame than the grid.
    """
    cavities = [name for name in CAVITIES if name in surfaces]
    if OUTER not in surfaces or not cavities:
        raise InvalidInputError(
            f"surfaces given are {sorted(surfaces)}; needed {OUTER} and at least one of {', '.join(CAVITIES)}"
        )
    closed = {name: close_surface(surfaces[name]) for name in (OUTER, *cavities)}
    timing = closed[OUTER].timing
    for name, series in closed.items():
        require_same_frame(grid.frame, series.frame, f"surface {name}")
        if not np.array_equal(series.timing.fractions, timing.fractions):
            raise InvalidInputError(f"surfaces {OUTER} and {name} have different phase times")
    values = np.zeros((len(timing), *grid.shape), dtype=np.uint8)
    for i in range(len(timing)):
        values[i][_inside(closed[OUTER], i, grid)] = WALL
        for name in cavities:
            values[i][_inside(closed[name], i, grid)] = BLOOD
        if progress is not None:
            progress((i + 1) / len(timing))
    return VolumeSeries(grid, values, timing)


def _inside(series: SurfaceSeries, phase: int, grid: Grid) -> BoolArray:
    return inside_mask(grid.to_index(series.vertices_mm[phase]), series.triangles, grid.shape)
