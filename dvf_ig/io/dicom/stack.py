"""Order cine images: slices along the normal, phases along the cycle, with none missing or repeated."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.timing.cycle import CycleTiming

from .header import CineImage

log = logging.getLogger(__name__)

SAME_PLACE_MM = 0.1
"""Slices this close are the same slice; positions have three decimals or more, slices are mm apart."""
SAME_DIRECTION = 1e-3
"""Largest difference of equal unit vectors: 0.06 degrees, 0.1 mm at the edge of the image."""
UNEVEN = 0.1
"""Allowed variation of the slice spacing as a fraction of it: 1 mm in 10 mm."""
MISSING_STEP = 1.6
"""Ratio of a trigger-time step to the usual step above which a phase is missing: one missing gives 2."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CineStack:
    """Images by slice and phase, with the grid that they form.

    Attributes:
        images: one row per slice, along the normal, with one image per phase.
        origin_mm, spacing_mm, direction: (3,), (3,), (3, 3) of columns, rows and slices, LPS.
        timing: of the phases.
    """

    images: tuple[tuple[CineImage, ...], ...]
    origin_mm: FloatArray
    spacing_mm: FloatArray
    direction: FloatArray
    timing: CycleTiming


def stack_of(folder: Path, images: Sequence[CineImage]) -> CineStack:
    """Put images in order by slice and phase.

    Raises:
        UnreadableFileError: the images are not one stack of one patient, complete in space and time;
            names what is missing or differs.
    """
    _require_one_acquisition(folder, images)
    first = images[0]
    along = np.array([image.position_mm @ first.normal for image in images])
    order = np.argsort(along, kind="stable")
    cuts = np.flatnonzero(np.diff(along[order]) > SAME_PLACE_MM) + 1
    groups = [[images[i] for i in group] for group in np.split(order, cuts)]
    heights = np.array([float(along[group].mean()) for group in np.split(order, cuts)])
    pitch = _pitch(folder, heights)
    timed = _timed(folder, images)
    slices = tuple(
        _phases(folder, group, height, timed) for group, height in zip(groups, heights, strict=True)
    )
    _require_equal_counts(folder, slices, heights)
    origin = slices[0][0].position_mm
    for row, height in zip(slices, heights, strict=True):
        shift = np.array([image.position_mm for image in row]) - origin
        sideways = shift - np.outer(shift @ first.normal, first.normal)
        if np.abs(sideways).max() > SAME_PLACE_MM:
            raise UnreadableFileError(
                f"{folder}: the slice at {height:.1f} mm is shifted sideways by "
                f"{np.linalg.norm(sideways, axis=1).max():.1f} mm against the first; resample it"
            )
    direction = np.column_stack([*first.axes, first.normal])
    spacing = np.array([*first.spacing_mm, pitch])
    return CineStack(slices, origin, spacing, direction, _timing(folder, slices, timed))


def _require_one_acquisition(folder: Path, images: Sequence[CineImage]) -> None:
    _require_one(folder, images, "patients", lambda one: f"'{one.patient}'")
    _require_one(folder, images, "frames of reference", lambda one: one.frame_of_reference)
    _require_one(folder, images, "matrix sizes", lambda one: f"{one.columns} x {one.rows}")
    first = images[0]
    for image in images:
        turned = np.abs(image.axes - first.axes).max() > SAME_DIRECTION
        if turned or np.abs(image.spacing_mm / first.spacing_mm - 1).max() > SAME_DIRECTION:
            raise UnreadableFileError(
                f"{folder} holds images of several {'orientations' if turned else 'pixel sizes'}: "
                f"{first.path.name} ({first.series_name}) and {image.path.name} ({image.series_name}); put "
                "the short-axis stack into a folder of its own"
            )


def _require_one(
    folder: Path, images: Sequence[CineImage], what: str, value: Callable[[CineImage], str]
) -> None:
    values = list(dict.fromkeys(value(image) for image in images))
    if len(values) > 1:
        raise UnreadableFileError(
            f"{folder} holds images of {len(values)} {what}: {', '.join(values[:4])}; put the one cine stack "
            "that is meant into a folder of its own"
        )


def _pitch(folder: Path, heights: FloatArray) -> float:
    """Distance of neighbouring slices, mm."""
    if len(heights) < 2:
        raise UnreadableFileError(f"{folder} holds one slice; needed a stack of short-axis slices")
    steps = np.diff(heights)
    usual = float(np.sort(steps)[(len(steps) - 1) // 2])
    worst = int(np.abs(steps - usual).argmax())
    if abs(steps[worst] - usual) > UNEVEN * usual:
        problem = "a slice is missing" if steps[worst] > 1.5 * usual else "slices are unevenly spaced"
        raise UnreadableFileError(
            f"{folder}: slices lie {usual:.1f} mm apart, but from {heights[worst]:.1f} to "
            f"{heights[worst + 1]:.1f} mm it is {steps[worst]:.1f} mm: {problem}"
        )
    return float((heights[-1] - heights[0]) / len(steps))


def _timed(folder: Path, images: Sequence[CineImage]) -> bool:
    """Whether trigger times are recorded."""
    without = [image for image in images if image.trigger_s is None]
    if without and len(without) < len(images):
        raise UnreadableFileError(
            f"{folder}: {len(without)} of {len(images)} images have no trigger time (0018,1060), for example "
            f"{without[0].path.name}; needed all or none"
        )
    return not without


def _phases(folder: Path, images: Sequence[CineImage], height: float, timed: bool) -> tuple[CineImage, ...]:
    """One slice in order of time."""
    ordered = sorted(images, key=lambda one: one.trigger_s or 0.0 if timed else float(one.number))
    times = np.array([one.trigger_s or 0.0 if timed else float(one.number) for one in ordered])
    steps = np.diff(times)
    same = np.flatnonzero(steps <= 0)
    if len(same):
        one, other = ordered[same[0]], ordered[same[0] + 1]
        when = f"trigger time {1000 * times[same[0]]:g} ms" if timed else f"number {times[same[0]]:g}"
        raise UnreadableFileError(
            f"{folder}: the slice at {height:.1f} mm has two images of {when}, {one.path.name} and "
            f"{other.path.name}: it was acquired twice, or these are phase images; keep one acquisition"
        )
    if len(steps) > 2 and (largest := int(steps.argmax())) >= 0:
        usual = float(np.median(steps))
        if steps[largest] > MISSING_STEP * usual:
            unit, scale = ("ms", 1000.0) if timed else ("", 1.0)
            raise UnreadableFileError(
                f"{folder}: a phase is missing in the slice at {height:.1f} mm, between "
                f"{scale * times[largest]:g} and {scale * times[largest + 1]:g} {unit}".rstrip()
            )
    return tuple(ordered)


def _require_equal_counts(folder: Path, slices: Sequence[Sequence[CineImage]], heights: FloatArray) -> None:
    counts = np.array([len(row) for row in slices])
    usual = int(np.bincount(counts).argmax())
    odd = np.flatnonzero(counts != usual)
    if len(odd):
        raise UnreadableFileError(
            f"{folder}: the slice at {heights[odd[0]]:.1f} mm has {counts[odd[0]]} phases, others {usual}: "
            "images are missing"
        )
    if usual < 2:
        raise UnreadableFileError(f"{folder} holds one phase; needed a cine through the cycle")


def _timing(folder: Path, slices: Sequence[Sequence[CineImage]], timed: bool) -> CycleTiming:
    """Mean over slices of trigger time over RR, each slice having been acquired at its own RR."""
    intervals = [one.rr_s for row in slices for one in row if one.rr_s is not None]
    rr_s = float(np.mean(intervals)) if intervals else None
    if not timed:
        if rr_s is None:
            return CycleTiming.uniform(len(slices[0]), 1.0, rr_assumed=True)
        return CycleTiming.uniform(len(slices[0]), rr_s)
    times = np.array([[one.trigger_s or 0.0 for one in row] for row in slices])
    own = [[one.rr_s for one in row if one.rr_s is not None] for row in slices]
    ends = times[:, -1] + np.diff(times, axis=1).mean(axis=1)
    recorded = np.array([np.mean(row) if row else np.nan for row in own])
    usable = np.isfinite(recorded) & (recorded > times[:, -1])
    if not usable.all():
        log.warning(
            "%s: no RR interval fits the trigger times; the cycle ends a step after its last phase", folder
        )
        recorded = ends
    fractions = (times / recorded[:, None]).mean(axis=0)
    return CycleTiming(fractions, float(recorded.mean()), rr_assumed=not usable.all())
