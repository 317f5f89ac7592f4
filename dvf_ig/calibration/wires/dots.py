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


@dataclass(frozen=True, slots=True)
class DotOptions:
    """Criteria by which an echo counts as a dot.

    Attributes:
        dot_mm: SD of the Gaussian that models a dot, about a pulse length.
        background_mm: SD of the Gaussian that models its surroundings.
        window_mm: a dot's echo lies within this distance of its peak along rows and columns...
        apart_mm: of peaks closer than this along rows and columns the strongest is kept.
        echo_share: ...and is what is joined to the peak and above this share of it...
        one_echo_share: ...or above the lowest share, from this one down, that keeps it within the window and
            apart from its neighbours.
        min_contrast: smallest peak above its surroundings, grey values after smoothing.
        most: dots kept, the strongest first.
    """

    dot_mm: float = 0.5
    background_mm: float = 2.0
    window_mm: float = 5.0
    apart_mm: float = 0.5
    echo_share: float = 0.35
    one_echo_share: float = 0.9
    min_contrast: float = 2.0
    most: int = 25


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
    options: DotOptions | None = None,
) -> Dots:
    """Find the brightest dots of one image.

    Peaks of a difference of Gaussians at the dot's scale; each is placed at the intensity-weighted centre of
    the echo around it.

    Args:
        image: (rows, columns) grey values.
        spacing_mm: approximate pixel size.
        clip: the part that shows ultrasound; None takes all.
    Raises:
        InvalidInputError: a pixel size that is not positive, or a clip outside the image.
    """
    options = options or DotOptions()
    if not spacing_mm > 0:
        raise InvalidInputError(f"pixel size is {spacing_mm:g} mm; it must be positive")
    part, left_top = _clipped(image, clip)
    block = max(1, int(options.dot_mm / spacing_mm / PIXELS_PER_SD))
    blocks = _blocks(part, block)
    pitch_mm = block * spacing_mm
    smooth = gaussian_filter(blocks, options.dot_mm / pitch_mm, truncate=3.0)
    contrast = smooth - gaussian_filter(blocks, options.background_mm / pitch_mm, truncate=3.0)
    peaks = _peaks(contrast, pitch_mm, options)
    half_window = max(1, round(options.window_mm / pitch_mm))
    centers = [_echo_center(smooth, peaks, i, half_window, options) for i in range(len(peaks))]
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


def _peaks(contrast: AnyArray, spacing_mm: float, options: DotOptions) -> IntArray:
    """(n, 2) row, column of the strongest local maxima."""
    side = 2 * max(1, round(options.apart_mm / spacing_mm)) + 1
    highest = (contrast == maximum_filter(contrast, size=side)) & (contrast > options.min_contrast)
    maxima = np.argwhere(highest)
    strongest = np.argsort(-contrast[maxima[:, 0], maxima[:, 1]], kind="stable")
    return np.asarray(maxima[strongest[: options.most]], dtype=np.int64)


def _echo_center(
    smooth: AnyArray, peaks: IntArray, which: int, half_window: int, options: DotOptions
) -> FloatArray:
    """(2,) column, row of the centre of intensity of one peak's echo, apart from its neighbours' echoes."""
    row, column = peaks[which].tolist()
    first = np.maximum(peaks[which] - half_window, 0)
    window = smooth[first[0] : row + half_window + 1, first[1] : column + half_window + 1].astype(np.float64)
    inside = peaks - first
    inside = inside[((inside >= 0) & (inside < window.shape)).all(axis=1)]
    levels = np.linspace(options.one_echo_share, options.echo_share, 5) * smooth[row, column]
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
