"""Read gated 3-D ultrasound from images or 4-D sequences: time in the cycle, grey levels, visible region.

The LPS coordinates of a file's header, in mm, are tracker coordinates.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import AnyArray, BoolArray, InvalidInputError, Rigid, TrackedVolume, UnreadableFileError
from dvf_ig.core.plausible import VOLUME_STEP_S
from dvf_ig.core.space.volume import Grid, Volume
from dvf_ig.io.reading import reading

from .volume import image_dimension, image_header, read_array

FRAME = "tracker"
SAME_SECTOR = 0.95
"""Dice coefficient of two visible regions from which they count as one sector; it is 0.998 or more in
synthetic images of one transducer.
"""
_PLACE = re.compile(r"(.+)([@=])([^@=]*)")
_SEQUENCE_MARK = b"Seq_Frame"
WHAT = "a 3-D ultrasound image (NIfTI, NRRD or MetaImage)"


@dataclass(frozen=True, slots=True)
class GatedVolumeFile:
    """A volume's file and when it was taken: either a phase or a time.

    Attributes:
        volume: number of the volume in a 4-D file, in order of time; None for a file of one volume.
        phase: fraction of the RR interval since the R peak, [0, 1).
        t_s: seconds on the clock of the ECG.
    """

    path: Path
    phase: float | None = None
    t_s: float | None = None
    volume: int | None = None


def gated_volume_files(texts: Sequence[str]) -> tuple[GatedVolumeFile, ...]:
    """Parse files named FILE@PHASE or FILE=SECONDS, in order.

    Raises:
        InvalidInputError: neither of the two, a phase outside [0, 1), no number, or a file named twice.
    """
    files = tuple(_gated_volume_file(text) for text in texts)
    seen: set[Path] = set()
    for file in files:
        resolved = file.path.resolve()
        if resolved in seen:
            raise InvalidInputError(f"{file.path} is named twice; a volume has one phase")
        seen.add(resolved)
    return files


def _gated_volume_file(text: str) -> GatedVolumeFile:
    match = _PLACE.fullmatch(text)
    try:
        if match is None:
            raise ValueError
        path, number = Path(match[1]), float(match[3])
    except ValueError as exc:
        raise InvalidInputError(
            f"'{text}' does not say its phase; write FILE@PHASE, a fraction of the RR "
            "interval such as us.nrrd@0.35, or FILE=SECONDS with an ECG"
        ) from exc
    if match[2] == "=":
        if not np.isfinite(number):
            raise InvalidInputError(f"'{text}': the time is {number} s; needed a finite one")
        return GatedVolumeFile(path, t_s=number)
    if not 0.0 <= number < 1.0:
        raise InvalidInputError(
            f"'{text}': the phase is {number:g}; needed a fraction of the RR interval, 0 to below 1"
        )
    return GatedVolumeFile(path, phase=number)


def sequence_volumes(files: Sequence[GatedVolumeFile]) -> tuple[GatedVolumeFile, ...]:
    """Split 4-D files with times (4-D echo as 3D Slicer's `.seq.nrrd`) into volumes, in order of time.

    FILE=SECONDS is the time of the first volume, FILE@PHASE its phase; then the file's own times are
    percentages of the RR interval.

    Raises:
        UnreadableFileError: absent, damaged, several volumes without times, or times of no ultrasound probe.
    """
    return tuple(volume for file in files for volume in _volumes_of(file))


def _volumes_of(file: GatedVolumeFile) -> tuple[GatedVolumeFile, ...]:
    path = file.path
    with reading(path, WHAT):
        _refuse_planes(path)
        header = image_header(path)
        if header.dimension != 4 or file.volume is not None:
            return (file,)
        if header.times is None:
            raise UnreadableFileError(
                f"{path} holds several volumes without their times; split it into one file per volume, and "
                "give the phase of each"
            )
        fractions = header.times.fractions(path)
        seconds = np.zeros(0) if fractions is not None else header.times.seconds(path)
        if (fractions is None) == (file.t_s is None):
            needed = "FILE=SECONDS, the time of its first volume" if fractions is None else "FILE@PHASE"
            raise UnreadableFileError(
                f"{path} holds volumes with times in '{header.times.unit[:20]}' ({header.times.field}); "
                f"write {needed}"
            )
        if fractions is not None:
            phases = ((file.phase or 0.0) + fractions - fractions[0]) % 1.0
            return tuple(GatedVolumeFile(path, float(phase), None, i) for i, phase in enumerate(phases))
        step, (low, high) = float(np.median(np.diff(seconds))), VOLUME_STEP_S
        if not low <= step <= high:
            raise UnreadableFileError(
                f"{path}: its volumes are {step:.4g} s apart by {header.times.field}; needed {low:g} to "
                f"{high:g}: check their unit"
            )
        times = (file.t_s or 0.0) + seconds - seconds[0]
        return tuple(GatedVolumeFile(path, None, float(t_s), i) for i, t_s in enumerate(times))


def read_gated_volumes(
    files: Sequence[GatedVolumeFile], model_phases: Sequence[float]
) -> tuple[TrackedVolume, ...]:
    """Read gated 3-D ultrasound images in the frame "tracker".

    Grey levels are log-compressed, 0 to 255 in any pixel type, or 0 to 1 in a floating-point image; NaN is
    black. The insonified region is taken from the images (`insonified_voxels`). Images of one size whose
    sectors agree to SAME_SECTOR come from one transducer and share the union of their regions.

    Args:
        files: NIfTI, NRRD or MetaImage whose LPS coordinates are the tracker's; voxels of any edges.
        model_phases: phase of each in the model's cycle, [0, 1).
    Raises:
        UnreadableFileError: absent, damaged, a sequence of planes, several volumes of which none is named
            (`sequence_volumes`), other grey levels, or black throughout.
    """
    volumes = {path: _read_images(path) for path in dict.fromkeys(file.path for file in files)}
    images = [_chosen(file, volumes[file.path]) for file in files]
    masks = _common_sectors([image.grid for image in images], [insonified_voxels(i.values) for i in images])
    pose = Rigid.identity(FRAME, FRAME)
    return tuple(
        TrackedVolume(image, Volume(image.grid, mask.astype(np.uint8)), pose, phase)
        for image, mask, phase in zip(images, masks, model_phases, strict=True)
    )


def insonified_voxels(grey: AnyArray) -> BoolArray:
    """Mark (nx, ny, nz) voxels between non-zero ones along an axis, repeatedly: includes dark blood.

    The sector of a phased or matrix array is convex, so all of it but black corners is marked; the black
    surround is excluded for any grid direction.
    """
    seen = np.asarray(grey != 0)
    count = -1
    while count != (count := int(np.count_nonzero(seen))):
        for axis in range(3):
            after = np.maximum.accumulate(seen, axis=axis)
            before = np.flip(np.maximum.accumulate(np.flip(seen, axis), axis=axis), axis)
            seen = after & before
    return seen


def _common_sectors(grids: Sequence[Grid], masks: Sequence[BoolArray]) -> list[BoolArray]:
    """Merge the insonified voxels of images that share a sector."""
    counts = [int(np.count_nonzero(mask)) for mask in masks]

    def share_sector(i: int, j: int) -> bool:
        same_grid = grids[i].shape == grids[j].shape and np.allclose(
            grids[i].spacing_mm, grids[j].spacing_mm, rtol=1e-3
        )
        both = int(np.count_nonzero(masks[i] & masks[j])) if same_grid else 0
        return 2 * both >= SAME_SECTOR * (counts[i] + counts[j])

    unions: dict[tuple[int, ...], BoolArray] = {}
    out = []
    for i, mask in enumerate(masks):
        sharing = tuple(j for j in range(len(masks)) if j == i or share_sector(i, j))
        if len(sharing) > 1 and sharing not in unions:
            unions[sharing] = insonified_voxels(np.logical_or.reduce([masks[j] for j in sharing]))
        out.append(unions.get(sharing, mask))
    return out


def _read_images(path: Path) -> tuple[Grid, NDArray[np.uint8]]:
    """Read grid and grey levels, (volumes, x, y, z)."""
    with reading(path, WHAT):
        _refuse_planes(path)
        dimension = image_dimension(path)
        grid, values = read_array(path, FRAME, dimension)
        return grid, _grey_levels(path, values.reshape(-1, *grid.shape))


def _chosen(file: GatedVolumeFile, volumes: tuple[Grid, NDArray[np.uint8]]) -> Volume:
    grid, grey = volumes
    if file.volume is None and len(grey) > 1:
        raise UnreadableFileError(
            f"{file.path} holds {len(grey)} volumes; split it into one file per volume, or give their times"
        )
    one = grey[file.volume or 0]
    if not one.any():
        raise UnreadableFileError(f"{file.path} is black throughout; needed an ultrasound image")
    return Volume(grid, one)


def _refuse_planes(path: Path) -> None:
    with path.open("rb") as file:
        head = file.read(65536)
    if ".igs." in path.name.lower() or _SEQUENCE_MARK in head:
        raise UnreadableFileError(
            f"{path} is a tracked sequence of planes, not a 3-D image; needed one gated volume per file"
        )


def _grey_levels(path: Path, values: AnyArray) -> NDArray[np.uint8]:
    real = values.dtype.kind == "f"
    finite = np.nan_to_num(values, nan=0.0, posinf=np.inf, neginf=-np.inf) if real else values
    low, high = float(finite.min()), float(finite.max())
    if low < 0 or high > 255:
        raise UnreadableFileError(
            f"{path} holds values from {low:g} to {high:g}; needed log-compressed grey levels of 0 to 255, "
            "or 0 to 1 in a floating-point image: rescale it"
        )
    if not real:
        return np.asarray(finite, dtype=np.uint8)
    return np.asarray(np.rint(finite * 255.0 if high <= 1.0 else finite), dtype=np.uint8)
