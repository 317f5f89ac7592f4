"""Headers of cine images: position, time in the cycle, patient."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io import limits

from .gdcm import Header, read_headers

PATIENT, SERIES, SERIES_NAME = "0010|0020", "0020|000e", "0008|103e"
FRAME_OF_REFERENCE, INSTANCE, FRAMES = "0020|0052", "0020|0013", "0028|0008"
POSITION, ORIENTATION, PIXEL_SPACING = "0020|0032", "0020|0037", "0028|0030"
TRIGGER_TIME, NOMINAL_INTERVAL, HEART_RATE = "0018|1060", "0018|1062", "0018|1088"
TAGS = (
    PATIENT,
    SERIES,
    SERIES_NAME,
    FRAME_OF_REFERENCE,
    INSTANCE,
    FRAMES,
    POSITION,
    ORIENTATION,
    PIXEL_SPACING,
    TRIGGER_TIME,
    NOMINAL_INTERVAL,
    HEART_RATE,
)
_UNIT = 1e-3
"""Tolerance of the stored axes of an image: unit length and orthogonality."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CineImage:
    """One image: a slice at a moment of the cycle.

    Attributes:
        path: its file.
        patient: (0010,0020); series, its name, frame of reference: of the acquisition.
        columns, rows: its matrix.
        position_mm: (3,) centre of the first pixel, LPS.
        axes: (2, 3) unit directions of growing column and of growing row, LPS.
        spacing_mm: (2,) between columns, between rows.
        trigger_s: since the R peak (0018,1060); None if not recorded.
        rr_s: from nominal interval (0018,1062) or heart rate (0018,1088); None if neither is recorded.
        number: of the instance within its series.
    """

    path: Path
    patient: str
    series: str
    series_name: str
    frame_of_reference: str
    columns: int
    rows: int
    position_mm: FloatArray
    axes: FloatArray
    spacing_mm: FloatArray
    trigger_s: float | None
    rr_s: float | None
    number: int

    @property
    def normal(self) -> FloatArray:
        """(3,) unit normal, right-handed with the axes."""
        return np.asarray(np.cross(self.axes[0], self.axes[1]))


def read_images(files: Sequence[Path]) -> list[CineImage]:
    """Read the headers of DICOM files, without their pixels.

    Raises:
        UnreadableFileError: a file cannot be read, holds several frames or colours, or has no position.
    """
    return [_image(file, header) for file, header in zip(files, read_headers(files, TAGS), strict=True)]


def _image(path: Path, header: Header) -> CineImage:
    tags = {name: value.strip(" \0") for name, value in header["tags"].items()}
    size = [int(n) for n in header["size"]]
    frames = tags.get(FRAMES, "1")
    if any(n != 1 for n in size[2:]) or frames not in ("", "1"):
        raise UnreadableFileError(
            f"{path} holds several frames (enhanced DICOM); convert the folder to NIfTI, for example with "
            "dcm2niix, and give its times as timing.json"
        )
    if header["components"] != 1 or not all(0 < n <= limits.AXIS for n in size):
        raise UnreadableFileError(f"{path} is not a grey-level image of a plausible size; export it again")
    axes = _numbers(path, tags, ORIENTATION, "orientation", 6).reshape(2, 3)
    if np.abs(axes @ axes.T - np.eye(2)).max() > _UNIT:
        raise UnreadableFileError(f"{path}: its axes are not orthogonal; export it again")
    rows_mm, columns_mm = _numbers(path, tags, PIXEL_SPACING, "pixel spacing", 2)
    low, high = limits.SPACING_MM
    if not (low <= rows_mm <= high and low <= columns_mm <= high):
        raise UnreadableFileError(f"{path}: its pixels have sides of {columns_mm:g} x {rows_mm:g} mm")
    position = _numbers(path, tags, POSITION, "position", 3)
    limits.require_lengths(position, f"the position of {path.name}")
    interval, rate = _optional(path, tags, NOMINAL_INTERVAL), _optional(path, tags, HEART_RATE)
    trigger = _optional(path, tags, TRIGGER_TIME)
    number = _optional(path, tags, INSTANCE)
    return CineImage(
        path=path,
        patient=tags.get(PATIENT, ""),
        series=tags.get(SERIES, ""),
        series_name=tags.get(SERIES_NAME, ""),
        frame_of_reference=tags.get(FRAME_OF_REFERENCE, ""),
        columns=size[0],
        rows=size[1],
        position_mm=position,
        axes=axes,
        spacing_mm=np.array([columns_mm, rows_mm]),
        trigger_s=None if trigger is None else trigger / 1000.0,
        rr_s=interval / 1000.0 if interval else (60.0 / rate if rate else None),
        number=0 if number is None else int(number),
    )


def _numbers(path: Path, tags: dict[str, str], tag: str, name: str, count: int) -> FloatArray:
    try:
        values = np.array([float(word) for word in tags.get(tag, "").split("\\")])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise UnreadableFileError(
            f"{path} has no {name} ({tag.replace('|', ',')}) of {count} numbers; export it from the "
            "scanner or the archive as an original image"
        )
    return values


def _optional(path: Path, tags: dict[str, str], tag: str) -> float | None:
    """Read an optional number; None if the tag is empty."""
    text = tags.get(tag, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not (0 <= value <= 1e9):
        raise UnreadableFileError(
            f"{path}: ({tag.replace('|', ',')}) is '{text[:30]}'; needed a number of at least 0"
        )
    return value
