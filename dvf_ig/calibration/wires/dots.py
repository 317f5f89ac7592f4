"""Bright dots in a B-mode image: echoes of wires that cross the image plane."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, label, maximum_filter

from dvf_ig.core import AnyArray, FloatArray, IntArray, InvalidInputError, read_only_arrays

Clip = tuple[int, int, int, int]
"""First column, first row, columns and rows of the part of an image that is searched."""
PIXELS_PER_SD = 2.0
"""Fine images are averaged over squares of pixels, as long as at least this many still span a dot's SD."""


DOT_MM = 0.5
"""Standard deviation of the Gaussian that models a dot, about a pulse length."""
BACKGROUND_MM = 2.0
"""Standard deviation of the Gaussian that models a dot's surroundings."""
WINDOW_MM = 5.0
"""A dot's echo is within this distance of its peak along rows and columns."""
APART_MM = 0.5
"""Of peaks closer than this along rows and columns the strongest is kept."""
ECHO_SHARE, ONE_ECHO_SHARE = 0.35, 0.9
"""A dot's echo is joined to its peak and above the lowest share of it, between these, that keeps it within
the window and apart from its neighbours."""
MIN_CONTRAST = 2.0
"""Smallest peak above its surroundings, grey values after smoothing."""
MOST_DOTS = 25
"""Dots kept if not stated otherwise, the strongest first."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Dots:
    """Candidate dots, strongest first.

    Attributes:
        points_px: (n, 2) column, row of each echo's centre of intensity.
        strength: (n,) contrast of the peak, grey values.
    """

    points_px: FloatArray
    strength: FloatArray

    def __len__(self) -> int:
        return len(self.strength)


def find_dots(
    image: NDArray[np.uint8],
    spacing_mm: float,
    *,
    clip: Clip | None = None,
    most: int = MOST_DOTS,
) -> Dots:
    """Find the brightest dots of one image.

    Peaks of a difference of Gaussians at the dot's scale; each is placed at the intensity-weighted centre of
    the echo around it.

    Args:
        image: (rows, columns) grey values.
        spacing_mm: approximate pixel size.
        clip: the part that shows ultrasound; None takes all.
        most: dots kept, the strongest first.
    Raises:
        InvalidInputError: a pixel size that is not positive, or a clip outside the image.
    """
    if not spacing_mm > 0:
        raise InvalidInputError(f"pixel size is {spacing_mm:g} mm; it must be positive")
    part, left_top = _clipped(image, clip)
    block = max(1, int(DOT_MM / spacing_mm / PIXELS_PER_SD))
    blocks = _blocks(part, block)
    pitch_mm = block * spacing_mm
    smooth = gaussian_filter(blocks, DOT_MM / pitch_mm, truncate=3.0)
    contrast = smooth - gaussian_filter(blocks, BACKGROUND_MM / pitch_mm, truncate=3.0)
    peaks = _peaks(contrast, pitch_mm, most)
    half_window = max(1, round(WINDOW_MM / pitch_mm))
    centers = [_echo_center(smooth, peaks, i, half_window) for i in range(len(peaks))]
    points = np.array(centers, dtype=np.float64).reshape(-1, 2) * block + 0.5 * (block - 1) + left_top
    return Dots(points, contrast[peaks[:, 0], peaks[:, 1]].astype(np.float64))


def _clipped(image: NDArray[np.uint8], clip: Clip | None) -> tuple[NDArray[np.uint8], tuple[int, int]]:
    """Crop an image to its searched part, and its first column and row."""
    rows, columns = image.shape
    left, top, width, height = clip or (0, 0, columns, rows)
    if min(left, top) < 0 or min(width, height) < 1 or left + width > columns or top + height > rows:
        raise InvalidInputError(
            f"the clip rectangle starts at column {left}, row {top} and measures {width} x {height} px; "
            f"it must lie in the image of {columns} x {rows} px"
        )
    return image[top : top + height, left : left + width], (left, top)


def _blocks(image: NDArray[np.uint8], size: int) -> NDArray[np.float32]:
    """Means over squares of pixels; what is left over at the right and at the bottom is dropped."""
    rows, columns = image.shape[0] // size, image.shape[1] // size
    whole = image[: rows * size, : columns * size].reshape(rows, size, columns, size)
    return np.asarray(whole.mean(axis=(1, 3), dtype=np.float32))


def _peaks(contrast: AnyArray, spacing_mm: float, most: int) -> IntArray:
    """(n, 2) row, column of the strongest local maxima."""
    side = 2 * max(1, round(APART_MM / spacing_mm)) + 1
    highest = (contrast == maximum_filter(contrast, size=side)) & (contrast > MIN_CONTRAST)
    maxima = np.argwhere(highest)
    strongest = np.argsort(-contrast[maxima[:, 0], maxima[:, 1]], kind="stable")
    return np.asarray(maxima[strongest[:most]], dtype=np.int64)


def _echo_center(smooth: AnyArray, peaks: IntArray, which: int, half_window: int) -> FloatArray:
    """(2,) column, row of the centre of intensity of one peak's echo, apart from its neighbours' echoes."""
    row, column = peaks[which].tolist()
    first = np.maximum(peaks[which] - half_window, 0)
    window = smooth[first[0] : row + half_window + 1, first[1] : column + half_window + 1].astype(np.float64)
    inside = peaks - first
    inside = inside[((inside >= 0) & (inside < window.shape)).all(axis=1)]
    levels = np.linspace(ONE_ECHO_SHARE, ECHO_SHARE, 5) * smooth[row, column]
    weight: FloatArray = window
    own = 0
    for step, level in enumerate(levels.tolist()):
        parts, _ = label(window >= level)
        wider = parts == parts[row - first[0], column - first[1]]
        joined = int(wider[inside[:, 0], inside[:, 1]].sum())
        rows, columns = np.flatnonzero(wider.any(axis=1)), np.flatnonzero(wider.any(axis=0))
        ends = np.array([[rows[0], columns[0]], [rows[-1], columns[-1]]])
        away = np.abs(ends + first - peaks[which]).max()
        if step and (joined > own or away >= half_window):
            break
        # above the level, so that pixels at the edge of the echo come in gradually
        weight, own = np.where(wider, window - level, 0.0), joined
    across = weight.sum(axis=0) @ np.arange(weight.shape[1])
    down = weight.sum(axis=1) @ np.arange(weight.shape[0])
    return np.asarray(first[::-1] + np.array([across, down]) / weight.sum())
