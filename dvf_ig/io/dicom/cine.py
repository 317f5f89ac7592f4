"""Read DICOM images, classic or enhanced, as one cyclic 4-D image: slices by position, phases by time."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import CycleTiming, Grid, UnreadableFileError, read_only_arrays
from dvf_ig.io import limits
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import reading

from .header import CineImage, read_images
from .process import read_pixels
from .stack import CineStack, stack_of

log = logging.getLogger(__name__)

_MARK, _PREAMBLE = b"DICM", 128
WHAT = "a folder of DICOM images"


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DicomCine:
    """A short-axis cine stack.

    Attributes:
        grid: LPS; values: (phases, columns, rows, slices).
        patient_id: shared by all images; empty if none is recorded.
        series: names of the series that it came in.
    """

    grid: Grid
    values: NDArray[np.float32] | NDArray[np.int16]
    timing: CycleTiming
    patient_id: str
    series: tuple[str, ...]


def is_dicom_folder(folder: Path) -> bool:
    """Return whether a folder, or one within it, holds a DICOM file; an enhanced one may stand alone."""
    exists = folder.is_dir() or folder.is_file()
    return exists and any(_is_dicom(path) for path in _regular_files(folder))


def read_dicom_cine(folder: Path, frame: str = "mr", *, timed: bool = True) -> DicomCine:
    """Read the one cine stack of a folder and the folders within it; skip other files.

    Slices are ordered along their common normal, phases by trigger time (0018,1060), which divided by the RR
    interval (0018,1062, or from the heart rate 0018,1088) gives the phase, averaged over slices, because each
    was acquired at its own RR. Without trigger times of a heart the temporal positions (0020,0100) order the
    phases, else the instance numbers, at i/N; without RR intervals the cycle ends one step after the last
    phase. Both are marked as assumed.

    Args:
        folder: or one enhanced file.
        frame: name of the images' LPS frame.
        timed: read the times of the phases; otherwise the caller knows them.
    Raises:
        UnreadableFileError: no DICOM, several patients, orientations or matrix sizes, a slice or a phase
            missing or present twice, tags that contradict each other, or an image that cannot be read.
    """
    with reading(folder, WHAT):
        stack, images = _stack(folder, timed=timed)
        flat = [image for row in stack.images for image in row]
        columns, rows = images[0].columns, images[0].rows
        needed = 4 * columns * rows * len(flat)
        if needed > limits.VOXEL_BYTES:
            raise UnreadableFileError(
                f"{folder}: its images need {needed:.3g} bytes; at most {limits.VOXEL_BYTES:.3g} can be read"
            )
        files = list(dict.fromkeys(image.path for image in images))
        stored = read_pixels(files, len(images), columns, rows)
        at = {(image.path, image.frame): i for i, image in enumerate(images)}
        pixels = stored[[at[image.path, image.frame] for image in flat]]
        for path in files:
            record_file(path)
        phases, slices = len(stack.images[0]), len(stack.images)
        values = pixels.reshape(slices, phases, rows, columns).transpose(1, 3, 2, 0)
        if not np.isfinite(values).all():
            raise UnreadableFileError(f"{folder}: an image holds grey levels that are not finite")
        grid = Grid(frame, (columns, rows, slices), stack.origin_mm, stack.spacing_mm, stack.direction)
        names = tuple(dict.fromkeys(image.series_name or image.series for image in images))
        return DicomCine(grid, whole_numbers(values), stack.timing, images[0].patient, names)


def dicom_patient_id(folder: Path) -> str:
    """Read the patient (0010,0020) of a cine folder; empty if none is recorded.

    Raises:
        UnreadableFileError: as `read_dicom_cine`.
    """
    with reading(folder, WHAT):
        return _stack(folder, timed=False)[1][0].patient


def _stack(folder: Path, *, timed: bool) -> tuple[CineStack, list[CineImage]]:
    images, left_out = read_images(dicom_files(folder))
    for one in left_out:
        log.warning("%s: %s was left out (%d files): %s", folder, one.series, one.images, one.reason)
    return stack_of(folder, images, timed=timed), images


def dicom_files(folder: Path) -> list[Path]:
    """List the DICOM files of a folder and the folders within it; says how many others were skipped."""
    candidates = _regular_files(folder)
    files = [path for path in candidates if _is_dicom(path)]
    if not files:
        raise UnreadableFileError(f"{folder} holds no DICOM image; needed the images of a short-axis cine")
    limits.require_count(len(files), limits.DICOM_FILES, "DICOM files")
    if doubles := sorted(folder.rglob("._*")):
        log.warning(
            "%s: %d files of macOS were skipped, for example %s", folder, len(doubles), doubles[0].name
        )
    skipped = len(candidates) - len(files)
    if skipped:
        log.warning("%s: %d files that are not DICOM images were skipped", folder, skipped)
    return files


def _regular_files(folder: Path) -> list[Path]:
    """List a file, or those below a folder by name, without links, hidden files and DICOMDIR."""
    if folder.is_file():
        return [folder]
    return sorted(
        path
        for path in folder.rglob("*")
        if path.is_file() and not path.is_symlink() and path.name[0] != "." and path.name != "DICOMDIR"
    )


def _is_dicom(path: Path) -> bool:
    with path.open("rb") as stream:
        stream.seek(_PREAMBLE)
        return stream.read(len(_MARK)) == _MARK


def whole_numbers(values: NDArray[np.float32]) -> NDArray[np.float32] | NDArray[np.int16]:
    """Convert to 16-bit integers if no value changes."""
    info = np.iinfo(np.int16)
    if values.min() >= info.min and values.max() <= info.max and (values == np.rint(values)).all():
        return values.astype(np.int16)
    return values
