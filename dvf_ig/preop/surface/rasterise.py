"""Label images from closed surfaces, for registration of surface-only models."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dvf_ig.core import BoolArray, CycleTiming, Grid, InvalidInputError, Mesh, SurfaceSeries, VolumeSeries
from dvf_ig.core.space.frames import require_same_frame
from dvf_ig.preop.distance.signed import inside_mask

from .chambers import CHAMBER_SURFACES
from .closing import close_surface

BACKGROUND, WALL, BLOOD = 0, 1, 2
OUTER = "EPICARDIAL"


def rasterise(
    surfaces: Mapping[str, SurfaceSeries], grid: Grid, *, progress: Callable[[float], None] | None = None
) -> VolumeSeries:
    """Label voxel centres (uint8): 0 background, 1 wall, 2 blood.

    Blood is inside LV_ENDOCARDIAL or RV_ENDOCARDIAL; the rest inside EPICARDIAL is wall. Openings are capped
    first.

    Raises:
        InvalidInputError: EPICARDIAL or both cavities missing, timings that differ, or a surface that cannot
            be closed.
        FrameMismatchError: a surface in another frame than the grid.
    """
    cavities = [name for name in CHAMBER_SURFACES if name in surfaces]
    if OUTER not in surfaces or not cavities:
        raise InvalidInputError(
            f"surfaces given are {sorted(surfaces)}; needed {OUTER} and at least one of "
            f"{', '.join(CHAMBER_SURFACES)}"
        )
    closed = {name: close_surface(surfaces[name]) for name in (OUTER, *cavities)}
    timing = closed[OUTER].timing
    for name, series in closed.items():
        if not np.array_equal(series.timing.fractions, timing.fractions):
            raise InvalidInputError(f"surfaces {OUTER} and {name} have different phase times")
    meshes = {name: [s.phase(i) for i in range(len(timing))] for name, s in closed.items()}
    return rasterise_meshes(meshes[OUTER], [meshes[name] for name in cavities], grid, timing, progress)


def rasterise_meshes(
    organ: Sequence[Mesh],
    chambers: Sequence[Sequence[Mesh]],
    grid: Grid,
    timing: CycleTiming,
    progress: Callable[[float], None] | None = None,
) -> VolumeSeries:
    """Label voxel centres by closed surfaces, one a phase, of the organ and of each chamber of blood.

    Raises:
        FrameMismatchError: a surface in another frame than the grid.
    """
    values = np.zeros((len(timing), *grid.shape), dtype=np.uint8)
    for i in range(len(timing)):
        values[i][_inside(organ[i], grid)] = WALL
        for chamber in chambers:
            values[i][_inside(chamber[i], grid)] = BLOOD
        if progress is not None:
            progress((i + 1) / len(timing))
    return VolumeSeries(grid, values, timing)


def _inside(mesh: Mesh, grid: Grid) -> BoolArray:
    require_same_frame(grid.frame, mesh.frame, "a surface to rasterise")
    return inside_mask(grid.to_index(mesh.vertices_mm), mesh.triangles, grid.shape)
