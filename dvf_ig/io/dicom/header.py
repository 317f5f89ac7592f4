"""Headers of cine images, classic (one image a file) or enhanced: position, time in the cycle, patient."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError, read_only_arrays
from dvf_ig.io import limits

from .process import Tags, read_tags

_CLASS = "1.2.840.10008.5.1.4.1.1."
"""First part of the classes of files (0008,0016)."""
SLICES_OF = tuple(f"{_CLASS}{number}" for number in (2, 4))
"""Classes of slices, CT and MR, and first parts of those of enhanced ones: without pixels one is damaged."""
SECONDARY_CAPTURES = f"{_CLASS}7"
"""First part of the classes of screen shots and scanned pages: they have no place in the body."""
_LEVELS = "PhotometricInterpretation"
PADDING_BYTES = 15
"""Most bytes after the pixels of a file."""
_UNIT = 1e-3
"""Tolerance of the stored axes of an image: unit length and orthogonality."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Images, or files without any, that are no part of a cine.

    Attributes:
        series: its name, or its number.
        images: how many it has.
        reason: why it was left out, as a user reads it.
    """

    series: str
    images: int
    reason: str


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CineImage:
    """One image: a slice at a moment of the cycle.

    Attributes:
        path: its file; frame: which of the file's, from 0.
        patient: (0010,0020); series, its name, frame of reference: of the acquisition.
        modality: (0008,0060); kinds: of the image (0008,0008), for example M for magnitude or P for phase.
        columns, rows: its matrix.
        position_mm: (3,) centre of the first pixel, LPS.
        axes: (2, 3) unit directions of growing column and of growing row, LPS.
        spacing_mm: (2,) between columns, between rows.
        slice_mm: stated thickness (0018,0050) and distance of slices (0018,0088); NaN if not recorded.
        trigger_s: since the R peak (0018,1060), (0020,9153) or (0020,9252); None if not recorded.
        rr_s: every stated RR interval: (0018,1062), (0020,9251), and from the heart rate (0018,1088).
        temporal: position in the cycle (0020,0100) or (0020,9128); None if not recorded.
        positions: stated number of temporal positions (0020,0105); None if not recorded.
        number: of the instance within its series, or of the frame in its file.
    """

    path: Path
    frame: int
    patient: str
    series: str
    series_name: str
    frame_of_reference: str
    modality: str
    kinds: tuple[str, ...]
    columns: int
    rows: int
    position_mm: FloatArray
    axes: FloatArray
    spacing_mm: FloatArray
    slice_mm: FloatArray
    trigger_s: float | None
    rr_s: tuple[float, ...]
    temporal: float | None
    positions: float | None
    number: int

    @property
    def normal(self) -> FloatArray:
        """(3,) unit normal, right-handed with the axes."""
        return np.asarray(np.cross(self.axes[0], self.axes[1]))


def read_images(files: Sequence[Path]) -> tuple[list[CineImage], list[LeftOut]]:
    """Read the headers of DICOM files, without their pixels, one per frame in the order of the files.

    Reports, segmentations, colour pictures and screen shots, which an archive exports along, are left out.

    Raises:
        UnreadableFileError: a file cannot be read, holds several frames without positions, states something
            twice with different values, or has no position; or every file was left out.
    """
    images: list[CineImage] = []
    others: Counter[tuple[str, str]] = Counter()
    for path, tags in zip(files, read_tags(files), strict=True):
        general = tags["general"]
        if reason := _no_slice(tags):
            name = general.get("SeriesDescription") or general.get("SeriesInstanceUID") or path.name
            others[name, reason] += 1
        else:
            images += _images(path, tags)
    left_out = [LeftOut(name, count, reason) for (name, reason), count in others.items()]
    if not images:
        every = "; ".join(f"{one.series}: {one.reason}" for one in left_out)
        raise UnreadableFileError(f"{files[0].parent} holds no DICOM image of a cine ({every})")
    return images, left_out


def _no_slice(tags: Tags) -> str:
    """Say why a file cannot be a slice of grey levels; "" if it may be one."""
    general = tags["general"]
    modality, kind = general.get("Modality", ""), general.get("SOPClassUID", "")
    if not tags["pixels"] and kind and not any(f"{kind}.".startswith(f"{one}.") for one in SLICES_OF):
        return f"{modality or 'files'} without pixels"
    if modality == "SEG":
        return "a segmentation: convert it to NIfTI or NRRD labels"
    if general.get("SamplesPerPixel", "1") != "1" or general.get(_LEVELS, "").startswith("PALETTE"):
        return "colour pictures"
    return "screen shots" if kind.startswith(SECONDARY_CAPTURES) else ""


def _images(path: Path, tags: Tags) -> list[CineImage]:
    general, frames = tags["general"], tags["frames"]
    if not tags["pixels"]:
        raise UnreadableFileError(f"{path} holds no pixels; copy or export it again")
    if tags["table"]:
        raise UnreadableFileError(
            f"{path}: its grey levels go through a table (0028,3000), which is not read; convert it to NIfTI"
        )
    if general.get(_LEVELS) == "MONOCHROME1":
        raise UnreadableFileError(
            f"{path}: its high grey levels are dark ({_LEVELS} MONOCHROME1); export it as MONOCHROME2"
        )
    stated = general.get("NumberOfFrames") or "1"
    if stated != str(len(frames)):
        raise UnreadableFileError(
            f"{path} holds {stated[:20]} frames, with positions of {len(frames)}; needed one for each: "
            "convert the folder to NIfTI, for example with dcm2niix, and give its times as timing.json"
        )
    columns, rows = (_optional(path, general, name) or 0 for name in ("Columns", "Rows"))
    if not all(0 < n <= limits.AXIS for n in (columns, rows)):
        raise UnreadableFileError(f"{path} is not a grey-level image of a plausible size; export it again")
    _require_whole_pixels(path, general, tags["pixel_bytes"], int(rows * columns) * len(frames))
    single = [_single(path, number, frame) for number, frame in enumerate(frames)]
    _require_one_scale(path, single)
    return [
        _image(path, number, {**general, **one}, enhanced=tags["enhanced"])
        for number, one in enumerate(single)
    ]


def _require_one_scale(path: Path, frames: Sequence[dict[str, str]]) -> None:
    scales = {(one.get("RescaleSlope", "1"), one.get("RescaleIntercept", "0")) for one in frames}
    if any(_zero(slope) for slope, _ in scales):
        raise UnreadableFileError(
            f"{path}: its RescaleSlope (0028,1053) is not a number other than 0; export it again"
        )
    if len(scales) > 1:
        texts = " and ".join(f"{slope}, {intercept}" for slope, intercept in sorted(scales)[:2])
        raise UnreadableFileError(
            f"{path}: its frames have different rescale slopes and intercepts ({texts}); convert it to "
            "classic DICOM, or to NIfTI"
        )


def _require_whole_pixels(path: Path, general: dict[str, str], stored: int | None, pixels: int) -> None:
    """Refuse uncompressed pixels of another size than the header states, or aligned in a way of their own."""
    allocated, bits = (_optional(path, general, name) for name in ("BitsAllocated", "BitsStored"))
    highest = _optional(path, general, "HighBit")
    if bits and highest is not None and highest + 1 != bits:
        raise UnreadableFileError(
            f"{path}: its pixels have {bits:g} bits (0028,0101), the highest of which is {highest:g} "
            f"(0028,0102); needed {bits - 1:g}: export it again"
        )
    needed = int(pixels * (allocated or 16) / 8)
    if stored is not None and not needed <= stored <= needed + PADDING_BYTES:
        raise UnreadableFileError(
            f"{path} holds {stored} bytes of pixels, its header states {needed}; copy or export it again"
        )


def _single(path: Path, number: int, frame: dict[str, list[str]]) -> dict[str, str]:
    """Take the one value of each tag; empty values state nothing."""
    out: dict[str, str] = {}
    for name, texts in frame.items():
        values = [text for text in texts if text]
        if len({_rounded(value) for value in values}) > 1:
            raise UnreadableFileError(
                f"{path}: frame {number + 1} states {name} as {values[0][:60]} and as {values[1][:60]}; "
                "export it from the scanner or the archive as an original image"
            )
        if values:
            out[name] = values[0]
    return out


def _zero(text: str) -> bool:
    try:
        return not abs(float(text)) > 0.0
    except ValueError:
        return True


def _rounded(text: str) -> tuple[float, ...] | str:
    try:
        return tuple(round(float(word), 4) for word in text.split("\\"))
    except ValueError:
        return text


def _image(path: Path, frame: int, tags: dict[str, str], *, enhanced: bool) -> CineImage:
    axes = _numbers(path, tags, "ImageOrientationPatient", "orientation", 6).reshape(2, 3)
    if np.abs(axes @ axes.T - np.eye(2)).max() > _UNIT:
        raise UnreadableFileError(f"{path}: its axes are not orthogonal; export it again")
    rows_mm, columns_mm = _numbers(path, tags, "PixelSpacing", "pixel spacing", 2)
    low, high = limits.VOXEL_MM
    if not (low <= rows_mm <= high and low <= columns_mm <= high):
        raise UnreadableFileError(
            f"{path}: its pixels have sides of {columns_mm:g} x {rows_mm:g} mm; needed {low:g} to {high:g}"
        )
    position = _numbers(path, tags, "ImagePositionPatient", "position", 3)
    limits.require_lengths(position, f"the position of {path.name}")
    number = {name: _optional(path, tags, name) for name in _OPTIONAL}
    interval = number["NominalInterval"] or number["RRIntervalTimeNominal"]
    delay = number["NominalCardiacTriggerDelayTime"]
    stated = (number["TriggerTime"], delay, number["ActualCardiacTriggerDelayTime"])
    trigger = next((value for value in stated if value is not None), None)
    percent = number["NominalPercentageOfCardiacPhase"]
    if trigger is None and percent is not None and interval:
        trigger = percent / 100.0 * interval
    temporal = number["TemporalPositionIdentifier"]
    rate, thickness, apart = (number[n] for n in ("HeartRate", "SliceThickness", "SpacingBetweenSlices"))
    return CineImage(
        path=path,
        frame=frame,
        patient=tags.get("PatientID", ""),
        series=tags.get("SeriesInstanceUID", ""),
        series_name=tags.get("SeriesDescription", ""),
        frame_of_reference=tags.get("FrameOfReferenceUID", ""),
        modality=tags.get("Modality", ""),
        kinds=tuple(tags.get("ImageType", "").upper().split("\\")),
        columns=int(tags["Columns"]),
        rows=int(tags["Rows"]),
        position_mm=position,
        axes=axes,
        spacing_mm=np.array([columns_mm, rows_mm]),
        slice_mm=np.array([thickness or np.nan, apart or np.nan]),
        trigger_s=None if trigger is None else trigger / 1000.0,
        rr_s=tuple(rr for rr in ((interval or 0.0) / 1000.0, 60.0 / rate if rate else 0.0) if rr),
        temporal=number["TemporalPositionIndex"] if temporal is None else temporal,
        positions=number["NumberOfTemporalPositions"],
        number=frame if enhanced else int(number["InstanceNumber"] or 0),
    )


_OPTIONAL = (
    *("TriggerTime", "NominalCardiacTriggerDelayTime", "ActualCardiacTriggerDelayTime"),
    *("NominalPercentageOfCardiacPhase", "NominalInterval", "RRIntervalTimeNominal", "HeartRate"),
    *("TemporalPositionIdentifier", "TemporalPositionIndex", "NumberOfTemporalPositions"),
    *("InstanceNumber", "SliceThickness", "SpacingBetweenSlices"),
)


def _numbers(path: Path, tags: dict[str, str], keyword: str, name: str, count: int) -> FloatArray:
    try:
        values = np.array([float(word) for word in tags.get(keyword, "").split("\\")])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise UnreadableFileError(
            f"{path} has no {name} ({keyword}) of {count} numbers; export it from the scanner or the archive "
            "as an original image"
        )
    return values


def _optional(path: Path, tags: dict[str, str], keyword: str) -> float | None:
    """Read an optional number; None if the tag is empty."""
    text = tags.get(keyword, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not (0 <= value <= 1e9):
        raise UnreadableFileError(f"{path}: {keyword} is '{text[:30]}'; needed a number of at least 0")
    return value
