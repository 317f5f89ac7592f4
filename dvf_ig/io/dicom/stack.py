"""Order cine images: slices along the normal, phases along the cycle, with none missing or repeated."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError, read_only_arrays
from dvf_ig.core.plausible import RR_S
from dvf_ig.core.timing.cycle import CycleTiming, require_whole_cycle

from .header import CineImage

log = logging.getLogger(__name__)

SAME_PLACE_MM = 0.1
"""Slices this close are the same slice; positions have three decimals or more, slices are mm apart."""
SAME_DIRECTION = 1e-3
"""Largest difference of equal unit vectors: 0.06 degrees, 0.1 mm at the edge of the image."""
NOT_GREY = frozenset(
    (
        "P",
        "PHASE",
        "PHASE MAP",
        "VELOCITY",
        "VELOCITY MAP",
        "R",
        "REAL",
        "I",
        "IMAGINARY",
        "MOSAIC",
        "LOCALIZER",
    )
)
"""Kinds of images (0008,0008) that are no slice of a cine."""
UNEVEN = 0.1
"""Allowed variation of the slice spacing as a fraction of it: 1 mm in 10 mm."""
SAME_RR = 1.2
"""Largest ratio of two statements of one RR interval; rates are whole beats/min."""
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


def stack_of(folder: Path, images: Sequence[CineImage], *, timed: bool = True) -> CineStack:
    """Put images in order by slice and phase.

    Args:
        timed: read the times of the phases; otherwise they are replaced by the caller's.

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
    _require_stated_pitch(folder, images, pitch)
    clock = choose_clock(folder, images)
    slices = tuple(
        ordered_phases(folder, group, height, clock) for group, height in zip(groups, heights, strict=True)
    )
    _require_equal_counts(folder, slices, heights)
    _require_one_order(folder, slices)
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
    timing = (
        cycle_timing(folder, slices, clock)
        if timed
        else CycleTiming.uniform(len(slices[0]), 1.0, rr_assumed=True)
    )
    return CineStack(slices, origin, spacing, direction, timing)


def _require_one_acquisition(folder: Path, images: Sequence[CineImage]) -> None:
    _require_one(folder, images, "patients", lambda one: f"'{one.patient}'")
    _require_one(folder, images, "frames of reference", lambda one: one.frame_of_reference)
    _require_one(folder, images, "matrix sizes", lambda one: f"{one.columns} x {one.rows}")
    _require_one(folder, images, "modalities", lambda one: one.modality)
    for image in images:
        if other := NOT_GREY.intersection(image.kinds):
            raise UnreadableFileError(
                f"{folder}: {_name(image)} ({image.series_name}) is an image of another kind (ImageType "
                f"{', '.join(sorted(other))}); keep the cine's own images"
            )
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
        raise UnreadableFileError(
            f"{folder} holds one slice, as far as its positions tell; needed a stack of short-axis slices, mm"
        )
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


def _require_stated_pitch(folder: Path, images: Sequence[CineImage], pitch: float) -> None:
    """Refuse positions that contradict the distance of slices that their series states.

    Some scanners state the gap instead. Series of one slice each state what the protocol had, not the stack.
    """
    thickness, apart = images[0].slice_mm
    fits = [
        abs(stated - pitch) <= UNEVEN * pitch for stated in (apart, apart + thickness) if np.isfinite(stated)
    ]
    if not fits or any(fits):
        return
    problem = (
        f"its slices are {pitch:.2f} mm apart by their positions (0020,0032), {apart:g} mm by "
        "SpacingBetweenSlices (0018,0088)"
    )
    if len({image.series for image in images}) > 1:
        log.warning("%s: %s; the positions are used", folder, problem)
        return
    raise UnreadableFileError(f"{folder}: {problem}; export it from the scanner or the archive again")


@dataclass(frozen=True, slots=True)
class _Clock:
    """The tag that orders the phases: its name, unit and value of an image, None if not recorded."""

    name: str
    unit: str
    scale: float
    value: Callable[[CineImage], float | None]

    def of(self, image: CineImage) -> float:
        return self.value(image) or 0.0


_TRIGGER = _Clock("trigger time", "ms", 1000.0, lambda image: image.trigger_s)
_TEMPORAL = _Clock("temporal position", "", 1.0, lambda image: image.temporal)
_NUMBER = _Clock("number", "", 1.0, lambda image: float(image.number))


def choose_clock(folder: Path, images: Sequence[CineImage]) -> _Clock:
    """Choose trigger times if they are those of a heart, else temporal positions, else instance numbers."""
    for clock, tag in ((_TRIGGER, "(0018,1060)"), (_TEMPORAL, "(0020,0100)")):
        without = [image for image in images if clock.value(image) is None]
        if len(without) == len(images):
            continue
        if without:
            raise UnreadableFileError(
                f"{folder}: {len(without)} of {len(images)} images have no {clock.name} {tag}, for example "
                f"{without[0].path.name}; needed all or none"
            )
        low, high = (clock.scale * limit(map(clock.of, images)) for limit in (min, max))
        if high > low and (clock is _TEMPORAL or high <= clock.scale * RR_S[1]):
            return clock
        if clock is _TRIGGER:
            log.warning(
                "%s: its trigger times (0018,1060), %g to %g ms, are not those of a heart; the phases are in "
                "order of %s, at equal steps",
                folder,
                low,
                high,
                "temporal positions (0020,0100)" if images[0].temporal else "instance numbers (0020,0013)",
            )
    return _NUMBER


def ordered_phases(
    folder: Path, images: Sequence[CineImage], height: float, clock: _Clock
) -> tuple[CineImage, ...]:
    """Order one slice by time."""
    ordered = sorted(images, key=clock.of)
    times = clock.scale * np.array([clock.of(one) for one in ordered])
    steps = np.diff(times)
    same = np.flatnonzero(steps <= 0)
    if len(same):
        one, other = ordered[same[0]], ordered[same[0] + 1]
        raise UnreadableFileError(
            f"{folder}: the slice at {height:.1f} mm has two images of {clock.name} {times[same[0]]:g} "
            f"{clock.unit}".rstrip()
            + f", {_name(one)} and {_name(other)}: it was acquired twice, or these are "
            "phase images; keep one acquisition"
        )
    if len(steps) > 2 and (largest := int(steps.argmax())) >= 0:
        usual = float(np.median(steps))
        if steps[largest] > MISSING_STEP * usual:
            raise UnreadableFileError(
                f"{folder}: a phase is missing in the slice at {height:.1f} mm, between "
                f"{times[largest]:g} and {times[largest + 1]:g} {clock.unit}".rstrip()
            )
    return tuple(ordered)


def _name(image: CineImage) -> str:
    return image.path.name if not image.frame else f"frame {image.frame + 1} of {image.path.name}"


def _require_one_order(folder: Path, slices: Sequence[Sequence[CineImage]]) -> None:
    """Refuse phases that trigger times and temporal positions order or count differently."""
    for row in slices:
        stated = np.array([np.nan if one.temporal is None else one.temporal for one in row])
        count = int(np.isfinite(stated).sum())
        if count not in (0, len(row)):
            raise UnreadableFileError(
                f"{folder}: {count} of {len(row)} images of a slice have a temporal position (0020,0100); "
                "needed all or none"
            )
        if not count or (stated == stated[0]).all():
            continue
        if (np.diff(stated) <= 0).any():
            at = int(np.argmax(np.diff(stated) <= 0))
            raise UnreadableFileError(
                f"{folder}: by trigger time {_name(row[at])} comes before {_name(row[at + 1])}, but their "
                f"temporal positions (0020,0100) are {stated[at]:g} and {stated[at + 1]:g}; export it from "
                "the scanner or the archive again"
            )
    counts = {one.positions for row in slices for one in row if one.positions and one.positions > 1}
    if counts and counts != {len(slices[0])}:
        raise UnreadableFileError(
            f"{folder} holds {len(slices[0])} phases, and its images state {max(counts):g} temporal "
            "positions (0020,0105): export the whole series again"
        )


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


def cycle_timing(folder: Path, slices: Sequence[Sequence[CineImage]], clock: _Clock) -> CycleTiming:
    """Mean over slices of trigger time over RR, each slice having been acquired at its own RR."""
    own = np.array([_rr_s(folder, row) for row in slices])
    if clock is not _TRIGGER:
        recorded = own[np.isfinite(own)]
        rr_s = float(recorded.mean()) if len(recorded) else 1.0
        return CycleTiming.uniform(len(slices[0]), rr_s, rr_assumed=not len(recorded))
    times = np.array([[one.trigger_s or 0.0 for one in row] for row in slices])
    ends = times[:, -1] + np.diff(times, axis=1).mean(axis=1)
    usable = np.isfinite(own) & (own > times[:, -1])
    if not usable.all():
        log.warning(
            "%s: no RR interval fits the trigger times; the cycle ends a step after its last phase", folder
        )
        own = ends
    fractions = (times / own[:, None]).mean(axis=0)
    require_whole_cycle(fractions, "trigger time (0018,1060)")
    return CycleTiming(fractions, float(own.mean()), rr_assumed=not usable.all())


def _rr_s(folder: Path, row: Sequence[CineImage]) -> float:
    """Mean RR interval of a slice; NaN if none is recorded.

    Raises:
        UnreadableFileError: RR interval and heart rate contradict each other.
    """
    for one in row:
        if len(one.rr_s) == 2 and max(one.rr_s) > SAME_RR * min(one.rr_s):
            raise UnreadableFileError(
                f"{folder}: {_name(one)} states an RR interval (0018,1062) of {1e3 * one.rr_s[0]:g} ms and a "
                f"heart rate (0018,1088) of {60 / one.rr_s[1]:g} beats/min; give --timing"
            )
    stated = [one.rr_s[0] for one in row if one.rr_s]
    return float(np.mean(stated)) if stated else np.nan
