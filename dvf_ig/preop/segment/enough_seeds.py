"""Whether seeds were enough: where the outline ends for want of seeds, and where no wall is found.

Too few seeds give a smooth outline all the same: that of the slices seeded, or that of the blood.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dvf_ig.core import BoolArray, Seeds, Volume

CUT_SHARE = 0.3
"""Of its largest section, the section in which an outline ends within the image: it was cut, not closed."""

THIN_WALL_MM, BARE_SHARE = 2.0, 0.25
"""Blood within so many mm of the background has no wall; a ventricle's valves are less of its outline."""


@dataclass(frozen=True, slots=True)
class SeedShortage:
    """What a segmentation from seeds lacks.

    Attributes:
        axis: along which its slices are counted: that of the largest voxels.
        unseeded: slices next to the outline that show its section nearly unchanged, and have no seed.
        without_wall: slices in which blood borders on the background over much of its outline.
    """

    axis: int
    unseeded: tuple[int, ...]
    without_wall: tuple[int, ...]

    @property
    def told(self) -> tuple[str, ...]:
        """A sentence for each want, with what to do; none where the seeds were enough."""
        across, found = "ijk"[self.axis], []
        if self.unseeded:
            found.append(
                f"the outline ends where the seeds do, not at the organ's end: set seeds (2 or more heart, 1 "
                f"cavity, 4 background around it) in slice {' and '.join(map(str, self.unseeded))} across "
                f"axis {across}, and on until the organ's last slice"
            )
        if self.without_wall:
            found.append(
                "the outline runs around the blood, not around the wall, in slice "
                f"{', '.join(map(str, self.without_wall))} across axis {across}: set 2 or more heart seeds "
                "in the wall on either side of the blood there, and background seeds close outside it"
            )
        return tuple(found)


def seed_shortage(labels: Volume, seeds: Seeds, *, cavity_label: int = 2) -> SeedShortage:
    """What labels grown from seeds lack; see `SeedShortage`."""
    spacing = labels.grid.spacing_mm
    axis = int(spacing.argmax())
    organ = np.moveaxis(labels.values != 0, axis, 0)
    blood = np.moveaxis(labels.values == cavity_label, axis, 0)
    area = organ.sum(axis=(1, 2))
    seeded = {
        int(k)
        for points in (seeds.heart, seeds.background, seeds.cavity)
        if len(points)
        for k in np.rint(labels.grid.to_index(points.xyz_mm)[:, axis])
    }
    filled = np.flatnonzero(area)
    unseeded = [
        int(last + step)
        for last, step in ((filled[0], -1), (filled[-1], 1))
        if 0 <= last + step < len(area)
        and int(last + step) not in seeded
        and area[last] > CUT_SHARE * area.max()
    ]
    in_plane = [float(s) for a, s in enumerate(spacing) if a != axis]
    bare = [
        int(k) for k in filled if blood[k].any() and _bare_share(organ[k], blood[k], in_plane) > BARE_SHARE
    ]
    return SeedShortage(axis, tuple(unseeded), tuple(bare))


def _bare_share(organ: BoolArray, blood: BoolArray, spacing_mm: list[float]) -> float:
    """Of the blood's outline in a slice, the share within THIN_WALL_MM of the background."""
    outline = blood & ~ndimage.binary_erosion(blood)
    to_background_mm = ndimage.distance_transform_edt(organ, sampling=spacing_mm)
    return float((to_background_mm[outline] <= THIN_WALL_MM).mean())
