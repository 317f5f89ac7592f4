"""Check of whether seeds were enough, by what grows from all of them and from a part of them.

Too few seeds also give a smooth outline: that of the slices seeded, of the blood, of one ventricle, or one
that has leaked into what lies next to the heart.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dvf_ig.core import BoolArray, FloatArray, Grid, InvalidInputError, Points, Seeds, Volume
from dvf_ig.preop.motion.image_match import blurred
from dvf_ig.preop.motion.quality import dice

from .seeded import BACKGROUND, CAVITY, segment_from_seeds

CUT_SHARE = 0.3
"""Share of the largest section from which an outline's last section counts as cut, not closed."""

THIN_WALL_MM, BARE_SHARE = 2.0, 0.6
"""Blood within this distance of the background has no wall; share of such blood in a slice from which it
lacks one. A right ventricle's wall is that thin: 18 of 47 good outlines in ACDC exceed a share of 0.25; blood
alone has 1."""

BESIDE_MM, CORE_MM, LEFT_OUT_SHARE = 15.0, 4.5, 0.045
"""Blood left out: as bright as the cavity's seeds, wider than twice `CORE_MM`, within `BESIDE_MM` of the
outline; its core's share of the organ is up to 0.044 (fat) in good outlines, from 0.06 if the right ventricle
is missed."""

PARTS, UNSTABLE_DICE, UNSTABLE_SHARE = 4, 0.82, 0.4
"""Seeds are left out in turn, a quarter at a time. A Dice with the full outline below the first value, or a
share of left-out background seeds within the heart above the second, shows an outline that depends on single
seeds."""

ENOUGH = {"heart": 4, "cavity": 2, "background": 6}
"""Seeds in a slice that suffice wherever they lie (Dice 0.86 to 0.93 on ACDC cines)."""


@dataclass(frozen=True, slots=True)
class SeedShortage:
    """Shortcomings of a segmentation from seeds.

    Attributes:
        axis: axis along which its slices are counted: that of the largest voxel size.
        unseeded: slices next to the outline that show its section nearly unchanged, and have no seed.
        without_wall: slices in which blood borders on the background over most of its outline.
        blood_left_out: slices with blood next to the outline.
        unstable: slices in which the outline moves when a quarter of the seeds is left out.
        more: (slice, seeds missing there as words) for each slice named above.
    """

    axis: int
    unseeded: tuple[int, ...]
    without_wall: tuple[int, ...]
    blood_left_out: tuple[int, ...]
    unstable: tuple[int, ...]
    more: tuple[tuple[int, str], ...]

    @property
    def told(self) -> tuple[str, ...]:
        """Sentences for each shortcoming, then the seeds to add; empty if the seeds were enough."""
        wants = (
            (self.unseeded, "the outline ends where the seeds do, not at the organ's end, before slice {}"),
            (self.without_wall, "the outline runs around the blood, not around the wall, in slice {}"),
            (
                self.blood_left_out,
                "blood lies next to the outline (perhaps a ventricle without seeds) in slice {}",
            ),
            (self.unstable, "the outline changes when a quarter of the seeds is left out, most in slice {}"),
        )
        sentences = [text.format(_listed(slices)) for slices, text in wants if slices]
        if sentences:
            listed = "; ".join(f"slice {k}: {words}" for k, words in self.more)
            on = ", and on until the organ's last slice" if self.unseeded else ""
            sentences.append(
                f"add seeds, spread around the heart and in each ventricle, background ones close outside "
                f"it (slices across axis {'ijk'[self.axis]}): {listed}{on}"
            )
        return tuple(sentences)


def seed_shortage(image: Volume, labels: Volume, seeds: Seeds) -> SeedShortage:
    """Find the shortcomings of labels grown from seeds.

    Args:
        image: the grey levels in which they grew.
        labels: `segment_from_seeds` of all of them.
    """
    axis = int(labels.grid.spacing_mm.argmax())
    unseeded = _unseeded(labels, seeds, axis)
    bare = _without_wall(labels, axis)
    left_out = _blood_left_out(image, labels, seeds, axis)
    unstable = () if unseeded else _unstable(image, labels, seeds, axis)
    named = sorted({*unseeded, *bare, *left_out, *unstable})
    more = tuple((k, _missing(seeds, labels.grid, axis, k)) for k in named)
    return SeedShortage(axis, unseeded, bare, left_out, unstable, more)


def _unseeded(labels: Volume, seeds: Seeds, axis: int) -> tuple[int, ...]:
    area = np.moveaxis(labels.values != BACKGROUND, axis, 0).sum(axis=(1, 2))
    filled = np.flatnonzero(area)
    if not len(filled):
        return ()
    groups = (seeds.heart, seeds.background, seeds.cavity)
    seeded = {int(k) for points in groups for k in _slices(points, labels.grid, axis)}
    ends = ((int(filled[0]), -1), (int(filled[-1]), 1))
    return tuple(
        last + step
        for last, step in ends
        if 0 <= last + step < len(area) and last + step not in seeded and area[last] > CUT_SHARE * area.max()
    )


def _without_wall(labels: Volume, axis: int) -> tuple[int, ...]:
    organ = np.moveaxis(labels.values != BACKGROUND, axis, 0)
    blood = np.moveaxis(labels.values == CAVITY, axis, 0)
    spacing = np.delete(labels.grid.spacing_mm, axis)
    return tuple(
        k
        for k in range(len(blood))
        if blood[k].any() and _bare_share(organ[k], blood[k], spacing) > BARE_SHARE
    )


def _bare_share(organ: BoolArray, blood: BoolArray, spacing_mm: FloatArray) -> float:
    """Compute the share of the blood's outline in a slice that is within THIN_WALL_MM of the background."""
    outline = blood & ~ndimage.binary_erosion(blood)
    to_background_mm = ndimage.distance_transform_edt(organ, sampling=spacing_mm)
    return float((to_background_mm[outline] <= THIN_WALL_MM).mean())


def _blood_left_out(image: Volume, labels: Volume, seeds: Seeds, axis: int) -> tuple[int, ...]:
    """Find slices with more than the allowed share, if the organ as a whole exceeds it."""
    organ = np.moveaxis(labels.values != BACKGROUND, axis, 0)
    if len(seeds.cavity) == 0 or not organ.any():
        return ()
    grey = blurred(image.values, image.grid.spacing_mm, 1.0)
    blood, wall = (float(np.median(_at(points, image.grid, grey))) for points in (seeds.cavity, seeds.heart))
    like_blood = (grey - wall) / (blood - wall) > 0.5 if blood != wall else np.zeros(grey.shape, np.bool_)
    outside = np.moveaxis(like_blood, axis, 0) & ~organ
    spacing = np.delete(labels.grid.spacing_mm, axis)
    cores = np.zeros(len(organ))
    for k in np.flatnonzero(organ.any(axis=(1, 2))):
        core = ndimage.distance_transform_edt(outside[k], sampling=spacing) > CORE_MM
        cores[k] = (core & (ndimage.distance_transform_edt(~organ[k], sampling=spacing) < BESIDE_MM)).sum()
    if cores.sum() <= LEFT_OUT_SHARE * organ.sum():
        return ()
    return tuple(np.flatnonzero(cores > LEFT_OUT_SHARE * organ.sum(axis=(1, 2))).tolist())


def _unstable(image: Volume, labels: Volume, seeds: Seeds, axis: int) -> tuple[int, ...]:
    """Find slices whose outline changes most when quarters of the seeds are left out, if too much."""
    organ = np.moveaxis(labels.values != BACKGROUND, axis, 0)
    alike, within, overlaps = np.ones(len(organ)), 0, []
    for part in range(PARTS):
        try:
            values = segment_from_seeds(image, _without(seeds, part)).values
        except InvalidInputError:
            continue
        there = np.moveaxis(values != BACKGROUND, axis, 0)
        overlaps.append(dice(organ, there))
        alike = np.minimum(alike, [dice(a, b) for a, b in zip(organ, there, strict=True)])
        left_out = Points(seeds.background.frame, seeds.background.xyz_mm[part::PARTS])
        within += int(np.count_nonzero(_at(left_out, image.grid, values)))
    if min(overlaps, default=1.0) >= UNSTABLE_DICE and within < UNSTABLE_SHARE * len(seeds.background):
        return ()
    return tuple(np.flatnonzero(alike <= max(float(alike.min()), UNSTABLE_DICE)).tolist())


def _without(seeds: Seeds, part: int) -> Seeds:
    """Leave out every fourth seed of each name; a name with one seed keeps it."""

    def kept(points: Points) -> Points:
        keep = np.arange(len(points)) % PARTS != part
        return Points(points.frame, points.xyz_mm[keep if keep.any() else slice(None)])

    return Seeds(kept(seeds.heart), kept(seeds.background), kept(seeds.cavity))


def _missing(seeds: Seeds, grid: Grid, axis: int, k: int) -> str:
    """Describe the seeds of each name to add in slice k: up to ENOUGH, and at least one."""
    seeded = {"heart": seeds.heart, "cavity": seeds.cavity, "background": seeds.background}
    counts = {
        name: max(1, ENOUGH[name] - int(np.count_nonzero(_slices(points, grid, axis) == k)))
        for name, points in seeded.items()
    }
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _slices(points: Points, grid: Grid, axis: int) -> FloatArray:
    """Compute the (n,) slice of each seed."""
    return np.rint(grid.to_index(points.xyz_mm)[:, axis]) if len(points) else np.zeros(0)


def _at(points: Points, grid: Grid, values: FloatArray) -> FloatArray:
    """Look up the (n,) values of the voxels in which points lie."""
    if len(points) == 0:
        return np.zeros(0)
    return np.asarray(values[tuple(np.rint(grid.to_index(points.xyz_mm)).astype(np.int64).T)])


def _listed(slices: tuple[int, ...]) -> str:
    return " and ".join(map(str, slices)) if len(slices) < 3 else ", ".join(map(str, slices))
