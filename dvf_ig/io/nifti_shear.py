"""Find sheared voxel axes in a NIfTI header, which ITK refuses obscurely or silently replaces."""

import gzip
import struct
import zlib
from pathlib import Path

import numpy as np

from ..core.arrays import FloatArray
from ..core.errors import UnreadableFileError

TOLERANCE = 1e-3
_HEADER_BYTES = {348: "nifti-1", 540: "nifti-2"}


def check_nifti_axes(path: Path) -> None:
    """Refuse a NIfTI file whose sform (used where its code is set) has axes that are not orthogonal.

    Other formats pass unread.

    Raises:
        UnreadableFileError: sheared axes; the message holds a command that repairs the file.
    """
    if not path.name.lower().endswith((".nii", ".nii.gz")):
        return
    axes = _sform_axes(path)
    if axes is None:
        return
    unit = axes / np.linalg.norm(axes, axis=0)
    shear = float(np.abs(unit.T @ unit - np.eye(3)).max())
    if not shear <= TOLERANCE:
        raise UnreadableFileError(
            f"{path}: the image axes are sheared ({np.degrees(np.arcsin(min(shear, 1.0))):.2f}° off "
            f"orthogonal in its sform); resample it with: nib-conform {path.name} straight_{path.name} "
            "--voxel-size 1 1 1"
        )


def _sform_axes(path: Path) -> FloatArray | None:
    """(3, 3) voxel axes of the sform, or None where the file sets none."""
    try:
        with gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as stream:
            header = stream.read(540)
    except (gzip.BadGzipFile, EOFError, zlib.error) as exc:
        raise UnreadableFileError(f"{path} is not a readable image: damaged gzip data ({exc})") from exc
    if len(header) < 348:
        raise UnreadableFileError(f"{path} is truncated: {len(header)} bytes, a NIfTI header has 348")
    for order in "<>":
        size = struct.unpack_from(f"{order}i", header)[0]
        if _HEADER_BYTES.get(size) == "nifti-1":
            code, rows = struct.unpack_from(f"{order}h", header, 254)[0], (f"{order}12f", 280)
        elif _HEADER_BYTES.get(size) == "nifti-2" and len(header) == 540:
            code, rows = struct.unpack_from(f"{order}i", header, 348)[0], (f"{order}12d", 400)
        else:
            continue
        axes = np.array(struct.unpack_from(rows[0], header, rows[1])).reshape(3, 4)[:, :3]
        return axes if code > 0 else None
    raise UnreadableFileError(f"{path} is not a NIfTI file: its header size is neither 348 nor 540")
