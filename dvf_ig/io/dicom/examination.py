"""Find the cines of a cardiac MR examination in one folder of all its series, by geometry and time.

The short-axis stack is the largest set of parallel slices at several times of the cycle; long-axis views are
single slices, as often in time, that stand across it and cut it. Names of series decide nothing. All else
(scouts, late enhancement, phase contrast, perfusion) is left out, with the reason.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import CycleTiming, Grid, UnreadableFileError, VolumeSeries
from dvf_ig.io import limits
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import reading

from .cine import WHAT, dicom_files, whole_numbers
from .header import CineImage, LeftOut, read_images
from .process import read_pixels
from .stack import SAME_PLACE_MM, CineStack, choose_clock, cycle_timing, ordered_phases, stack_of

LEAST_PHASES = 8
"""Fewer times of the cycle are no cine: perfusion and scouts have one a beat, cines 13 or more."""
LEAST_SLICES = 4
"""Fewer parallel slices are no stack."""
ACROSS = 0.5
"""Largest cosine between the normals of a long-axis view and of the stack: 60 to 90 degrees."""
SAME_AXES = 0.02
"""Largest difference of the axes of parallel slices: 1 degree."""


@dataclass(frozen=True, slots=True, eq=False)
class DicomExamination:
    """Cines of one examination.

    Attributes:
        sax: the short-axis stack.
        views: long-axis cines, one slice each; names: of their series.
        left_out: every other series.
        patient_id: shared by all images; empty if none is recorded.
    """

    sax: VolumeSeries
    views: tuple[VolumeSeries, ...]
    names: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    patient_id: str


@dataclass(frozen=True, slots=True, eq=False)
class _Slices:
    """Images of one geometry: parallel slices of one matrix and pixel size."""

    images: tuple[CineImage, ...]

    @property
    def first(self) -> CineImage:
        return self.images[0]

    @property
    def places(self) -> int:
        """Number of different positions along the normal."""
        along = np.sort([image.position_mm @ self.first.normal for image in self.images])
        return 1 + int(np.count_nonzero(np.diff(along) > SAME_PLACE_MM))

    @property
    def name(self) -> str:
        names = dict.fromkeys(image.series_name or image.series for image in self.images)
        return ", ".join(list(names)[:3])


def is_examination(folder: Path) -> bool:
    """Return whether DICOM files of a folder have several geometries, as one stack alone has not.

    Raises:
        UnreadableFileError: a header that cannot be read.
    """
    with reading(folder, WHAT):
        return len(_by_geometry(read_images(dicom_files(folder))[0])) > 1


def read_dicom_examination(folder: Path, frame: str = "mr") -> DicomExamination:
    """Read the short-axis stack and the long-axis cines of a folder and the folders within it.

    Args:
        frame: name of the images' LPS frame.
    Raises:
        UnreadableFileError: no DICOM, several patients, an image that cannot be read, or no short-axis
            stack; says of every series why it is none.
    """
    with reading(folder, WHAT):
        images, no_images = read_images(dicom_files(folder))
        patients = list(dict.fromkeys(image.patient for image in images))
        if len(patients) > 1:
            raise UnreadableFileError(
                f"{folder} holds images of {len(patients)} patients: {', '.join(patients[:4])}; give the "
                "examination of one"
            )
        cines, left_out = _cines(images)
        left_out += no_images
        sax, rest, refused = _short_axis(folder, cines, images, frame)
        if sax is None:
            every = "; ".join(f"{one.series}: {one.reason}" for one in (*refused, *left_out))
            raise UnreadableFileError(f"{folder} holds no short-axis cine stack ({every})")
        views, names, others = [], [], []
        for slices in rest:
            try:
                reason = _no_view(slices, sax.grid)
                view = None if reason else _view(folder, slices, images, frame)
            except UnreadableFileError as exc:
                reason, view = str(exc), None
            if view is None:
                others.append(LeftOut(slices.name, len(slices.images), reason))
            else:
                views.append(view)
                names.append(slices.name)
        return DicomExamination(sax, tuple(views), tuple(names), (*refused, *others, *left_out), patients[0])


def _cines(images: Sequence[CineImage]) -> tuple[list[_Slices], list[LeftOut]]:
    """Cine images by geometry, and the series that are no cines."""
    by_series: dict[str, list[CineImage]] = defaultdict(list)
    for image in images:
        by_series[image.series].append(image)
    chosen: list[CineImage] = []
    left_out = []
    for members in by_series.values():
        parts = _by_geometry(members)
        phases = max(len(part.images) / part.places for part in parts)
        if phases < LEAST_PHASES:
            reason = f"{phases:.0f} images a slice; needed {LEAST_PHASES} or more times of the cycle"
            left_out.append(LeftOut(_Slices(tuple(members)).name, len(members), reason))
        else:
            chosen += members
    return _by_geometry(chosen), left_out


def _by_geometry(images: Sequence[CineImage]) -> list[_Slices]:
    """Images by matrix, pixel size, orientation and frame of reference, in the order of their first one."""
    groups: list[list[CineImage]] = []
    for image in images:
        for group in groups:
            if _parallel(group[0], image):
                group.append(image)
                break
        else:
            groups.append([image])
    return [_Slices(tuple(group)) for group in groups]


def _parallel(a: CineImage, b: CineImage) -> bool:
    return (
        (a.columns, a.rows, a.frame_of_reference) == (b.columns, b.rows, b.frame_of_reference)
        and bool(np.allclose(a.spacing_mm, b.spacing_mm, rtol=1e-3))
        and float(np.abs(a.axes - b.axes).max()) < SAME_AXES
    )


def _short_axis(
    folder: Path, cines: Sequence[_Slices], every: Sequence[CineImage], frame: str
) -> tuple[VolumeSeries | None, list[_Slices], list[LeftOut]]:
    """The stack with the most slices that is whole, single slices, and stacks that are not taken."""
    refused: list[LeftOut] = []
    large = sorted((one for one in cines if one.places >= LEAST_SLICES), key=lambda one: -one.places)
    singles = [part for one in cines if one.places < LEAST_SLICES for part in _by_place(one)]
    sax = None
    for slices in large:
        if sax is not None:
            refused.append(_left_out(slices, "another stack of parallel slices, with fewer of them"))
            continue
        try:
            stack, extra = _whole_stack(folder, slices)
        except UnreadableFileError as exc:
            refused.append(_left_out(slices, str(exc)))
            continue
        refused += extra
        size = (slices.first.columns, slices.first.rows, len(stack.images))
        grid = Grid(frame, size, stack.origin_mm, stack.spacing_mm, stack.direction)
        sax = _series(folder, grid, stack.images, every, stack.timing)
    if sax is None:
        refused += [_left_out(one, f"1 parallel slice; needed {LEAST_SLICES}") for one in singles]
    return sax, singles, refused


def _whole_stack(folder: Path, slices: _Slices) -> tuple[CineStack, list[LeftOut]]:
    """Order a stack; where it is not whole, without the one series that keeps it from being so.

    Raises:
        UnreadableFileError: no stack with or without any one of its series; says what is wrong with all.
    """
    try:
        return stack_of(folder, slices.images), []
    except UnreadableFileError as exc:
        for series in dict.fromkeys(image.series for image in slices.images):
            others = tuple(image for image in slices.images if image.series != series)
            if not others or _Slices(others).places < LEAST_SLICES:
                continue
            try:
                stack = stack_of(folder, others)
            except UnreadableFileError:
                continue
            own = _Slices(tuple(image for image in slices.images if image.series == series))
            return stack, [_left_out(own, f"the stack is whole without it ({exc})")]
        raise


def _by_place(slices: _Slices) -> list[_Slices]:
    """Parallel slices one by one."""
    along = np.array([image.position_mm @ slices.first.normal for image in slices.images])
    order = np.argsort(along, kind="stable")
    cuts = np.flatnonzero(np.diff(along[order]) > SAME_PLACE_MM) + 1
    return [_Slices(tuple(slices.images[i] for i in part)) for part in np.split(order, cuts)]


def _left_out(slices: _Slices, reason: str) -> LeftOut:
    return LeftOut(slices.name, len(slices.images), reason)


def _no_view(slices: _Slices, sax: Grid) -> str:
    """Return why slices are no long-axis view of a stack; empty if they are one."""
    first = slices.first
    if abs(float(first.normal @ sax.direction[:, 2])) > ACROSS:
        return "a single slice along the stack's planes, not across them"
    middle = sax.to_mm((np.array(sax.shape) - 1.0) / 2.0)
    beside_mm = abs(float((middle - first.position_mm) @ first.normal))
    if beside_mm > 0.5 * sax.shape[0] * sax.spacing_mm[0]:
        return f"a single slice that passes the stack {beside_mm:.0f} mm from its middle"
    return ""


def _view(folder: Path, slices: _Slices, every: Sequence[CineImage], frame: str) -> VolumeSeries:
    """One slice through the cycle; its thickness, which no force depends on, is taken as its pixels' size.

    Raises:
        UnreadableFileError: a phase is missing or present twice.
    """
    first = slices.first
    clock = choose_clock(folder, slices.images)
    row = ordered_phases(folder, slices.images, float(first.position_mm @ first.normal), clock)
    spacing = np.array([*first.spacing_mm, float(first.spacing_mm.mean())])
    direction = np.column_stack([*first.axes, first.normal])
    grid = Grid(frame, (first.columns, first.rows, 1), first.position_mm, spacing, direction)
    return _series(folder, grid, (row,), every, cycle_timing(folder, (row,), clock))


def _series(
    folder: Path,
    grid: Grid,
    rows: Sequence[Sequence[CineImage]],
    every: Sequence[CineImage],
    timing: CycleTiming,
) -> VolumeSeries:
    """Read the grey levels of images by slice and phase; `every` image of the folder says what files hold."""
    flat = [image for row in rows for image in row]
    files = list(dict.fromkeys(image.path for image in flat))
    columns, height, slices = grid.shape
    images = [image for image in every if image.path in set(files)]
    limits.require_count(4 * columns * height * len(images), limits.VOXEL_BYTES, "bytes of images")
    images.sort(key=lambda image: files.index(image.path))
    stored = read_pixels(files, len(images), columns, height)
    at = {(image.path, image.frame): i for i, image in enumerate(images)}
    pixels = stored[[at[image.path, image.frame] for image in flat]]
    for path in files:
        record_file(path)
    values = pixels.reshape(slices, len(timing), height, columns).transpose(1, 3, 2, 0)
    if not np.isfinite(values).all():
        raise UnreadableFileError(f"{folder}: an image holds grey levels that are not finite")
    return VolumeSeries(grid, whole_numbers(values), timing)
