"""Orientation of ultrasound images: PLUS's image coordinates are those of MF, whatever a file stores.

PLUS turns B-mode images to MF when it reads a sequence, so ImageToProbe, fCal's points and the images in
3D Slicer are in MF: columns from the marked side (M) of the probe to the unmarked (U), rows away from the
transducer (F; N towards it). FM has the lines of the transducer as rows, before scan conversion. A third
letter orders slices. Source: PlusLib, igsioVideoFrame::GetOrientedClippedImage.
"""

import re
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import AnyArray, FloatArray
from dvf_ig.core.errors import UnreadableFileError

UNKNOWN = "XX"
_ORIENTATION = re.compile(r"([MU][FN]|[FN][MU])[AD]?")


def require_orientation(path: Path, text: str) -> str:
    """Return an orientation that PLUS writes for 2-D images, or UNKNOWN.

    Raises:
        UnreadableFileError: another one, for example of a volume.
    """
    word = text.strip().upper()
    if word in ("", "XX", "XXX"):
        return UNKNOWN
    if _ORIENTATION.fullmatch(word) is None:
        raise UnreadableFileError(
            f"{path}: UltrasoundImageOrientation is '{text[:20]}'; needed that of 2-D images (MF, UF, MN "
            "or UN): save it again as a sequence of images"
        )
    return word


def turned_orientation(stored: str) -> str | None:
    """Return the orientation after `turned_images`; None if images in `stored` are not turned."""
    return f"MF{stored[2:]}" if stored[:2] in ("UF", "MN", "UN") else None


def turned_images(images: AnyArray, stored: str) -> AnyArray:
    """Turn (n, rows, columns) images in UF, MN or UN to MF; others stay as they are."""
    if turned_orientation(stored) is None:
        return images
    flips = tuple(axis for axis, letter in ((1, "N"), (2, "U")) if letter in stored[:2])
    return np.ascontiguousarray(np.flip(images, flips))


def turned_points(points_px: FloatArray, stored: str, shape: tuple[int, int]) -> FloatArray:
    """Turn (…, 2) positions, column and row of the stored image, as `turned_images` does with the image.

    Args:
        shape: rows and columns of the image.
    """
    points = np.array(points_px)
    for axis, letter in ((0, "U"), (1, "N")):
        if turned_orientation(stored) is not None and letter in stored[:2]:
            points[..., axis] = shape[1 - axis] - 1 - points[..., axis]
    return points
