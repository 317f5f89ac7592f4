"""Walls that labels lack: most experts label the left ventricle's wall, and of the right its blood alone."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, generate_binary_structure

from dvf_ig.core import BoolArray, FloatArray, VolumeSeries

RIGHT_WALL_MM, RIGHT_WALL_SD_MM = 3.0, 1.0
"""Thickness of a right ventricle's free wall at end-diastole, and its standard deviation over patients."""
MOST_BARE = 0.25
"""Share of a cavity's outline within slices that may lack a wall: 0.57 to 0.67 of the right ventricles of
patients whose expert has not labelled it; none of their left ones, at most 0.04 of synthetic chambers."""
SMALLEST_VENTRICLE = 0.25
"""Of the largest cavity: 0.3 and more are right ventricles beside dilated left ones, 0.1 an auricle."""
_IN_SLICE = generate_binary_structure(3, 1) & np.array([False, True, False])
"""A voxel and its four neighbours in a slice."""


def missing_walls(
    organ: BoolArray, cavities: Sequence[BoolArray], names: Sequence[str]
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Find cavities that border on the background: there the organ's surface lies on blood, within the heart.

    Where another cavity has its wall, the left ventricle's, one without is taken for a right ventricle, whose
    wall is to be added (`with_walls`). A left ventricle's, 6 to 15 mm, and that of a small cavity such as an
    auricle are not guessed, but told. A cavity that is not of the organ needs no wall.

    Args:
        organ: (nx, ny, nz) voxels within the guarded surface.
        cavities, names: of the blood.
    Returns:
        the places in `cavities` whose wall is to be added, and what the user must know in sentences.
    """
    within = [2 * int((cavity & organ).sum()) > int(cavity.sum()) for cavity in cavities]
    bare = [k for k, cavity in enumerate(cavities) if within[k] and _bare_share(cavity, organ) > MOST_BARE]
    size = [int(cavity.sum()) for cavity in cavities]
    added, told = [], []
    for place in bare:
        if len(bare) < sum(within) and size[place] >= SMALLEST_VENTRICLE * max(size):
            added.append(place)
            follows = (
                f"{RIGHT_WALL_MM:g} ± {RIGHT_WALL_SD_MM:g} mm are added around its blood, as thick as a "
                "right ventricle's wall commonly is; label that wall if it is another"
            )
        else:
            follows = (
                "there the surface of its blood is guarded, which lies within the heart by the wall's "
                "thickness; label that wall, or widen the fixture (margin)"
            )
        told.append(f"the wall of {names[place]} is not labelled: {follows}")
    return tuple(added), tuple(told)


def _bare_share(cavity: BoolArray, organ: BoolArray) -> float:
    """Share of a cavity's outline within slices that borders on no part of the organ."""
    beside = binary_dilation(cavity, _IN_SLICE) & ~cavity
    return float((beside & ~organ).sum() / max(int(beside.sum()), 1))


def with_walls(organ: BoolArray, cavities: Sequence[BoolArray], spacing_mm: FloatArray) -> BoolArray:
    """Add a wall of RIGHT_WALL_MM around cavities to an organ, slice by slice.

    Args:
        spacing_mm: (3,) voxel pitch.
    """
    reach_mm = RIGHT_WALL_MM + 0.5 * float(spacing_mm[:2].mean())  # blood goes half a voxel past its centres
    walled = organ.copy()
    for cavity in cavities:
        for k in np.flatnonzero(cavity.any(axis=(0, 1))):
            walled[:, :, k] |= distance_transform_edt(~cavity[:, :, k], sampling=spacing_mm[:2]) < reach_mm
    return walled


def labels_with_walls(
    labels: VolumeSeries, organ: Sequence[int], cavities: Sequence[int], names: Sequence[str]
) -> tuple[VolumeSeries, tuple[int, ...], tuple[str, ...]]:
    """Give the walls that `missing_walls` finds in the first phase a label of their own, in every phase.

    Returns:
        the labels, the values of the organ with its walls, and what the user must know in sentences.
    """
    first = labels.values[0]
    added, told = missing_walls(np.isin(first, organ), [first == value for value in cavities], names)
    if not added:
        return labels, tuple(organ), told
    wall = int(labels.values.max()) + 1
    values = labels.values.astype(np.promote_types(labels.values.dtype, np.int16))
    for phase in values:
        inside = np.isin(phase, organ)
        phase[with_walls(inside, [phase == cavities[k] for k in added], labels.grid.spacing_mm) & ~inside] = (
            wall
        )
    return VolumeSeries(labels.grid, values, labels.timing), (*organ, wall), told
