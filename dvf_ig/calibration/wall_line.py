"""A flat wall, or the floor of a water tank, as a straight line in each ultrasound image."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, QualityGateError, Trace, read_only_arrays

BRIGHT_SHARE = 0.3
"""A column's echo counts when it reaches this share of the image's brightest echo."""
MIN_COLUMNS = 0.1
"""Fewest columns that must show the floor, as a share of the image's width."""
TOLERANCE_PX = 4.0
"""Distance from the line within which a column supports it."""
MIN_SUPPORT = 0.5
"""Share of the bright columns that must lie on the line."""
MAX_SLOPE_DEG = 40.0
"""Steepest floor accepted."""
HYPOTHESES = 60
"""Pairs of columns tried."""
MIN_CONTRAST = 20.0
"""Smallest grey value, above the still background, that counts as an echo."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class WallLines:
    """Lines row = row_px + slope · (column − column_px), one a frame.

    Attributes:
        column_px: the column at which rows are given: the image's centre.
        row_px, slope: (n,) NaN if no line was found.
        is_found: (n,).
    """

    column_px: float
    row_px: FloatArray
    slope: FloatArray
    is_found: BoolArray

    def end_points_px(self, valid: BoolArray) -> FloatArray:
        """(n, 2, 2) column, row of two points of each line, half a half-width from the centre; else NaN."""
        step = 0.25 * (2 * self.column_px + 1) * np.array([-1.0, 1.0])
        columns = np.broadcast_to(self.column_px + step, (len(self.row_px), 2))
        points = np.stack([columns, self.row_px[:, None] + self.slope[:, None] * step], axis=2)
        return np.where((self.is_found & valid)[:, None, None], points, np.nan)


def find_wall_lines(images: NDArray[np.uint8], *, rng: Generator) -> WallLines:
    """Find the strongest straight echo of each frame.

    What does not change between frames (scale, text, transducer face) is removed first.

    Args:
        images: (n, rows, columns) grey values, depth along rows.
        rng: draws the pairs of columns.
    """
    count, _, columns = images.shape
    still = np.median(images[:: max(1, count // 24)], axis=0)
    center = (columns - 1) / 2
    row, slope = np.full(count, np.nan), np.full(count, np.nan)
    for i in range(count):
        line = _line(images[i].astype(np.float64) - still, center, rng)
        if line is not None:
            row[i], slope[i] = line
    return WallLines(center, row, slope, np.isfinite(row))


def wall_trace(
    t_s: FloatArray, images: NDArray[np.uint8], valid: BoolArray, *, rng: Generator
) -> Trace:  # fmt: skip
    """Trace the row of the tank's floor at the image centre over time, skipping frames without one.

    Raises:
        QualityGateError: fewer than half of the valid frames show a floor.
        InvalidInputError: no valid frame.
    """
    usable = np.flatnonzero(valid)
    if len(usable) == 0:
        raise InvalidInputError(f"none of {len(valid)} video frames is valid; record the video again")
    lines = find_wall_lines(images[usable], rng=rng)
    if lines.is_found.sum() < max(2, len(usable) / 2):
        raise QualityGateError(
            f"the tank's floor shows as a straight line in {int(lines.is_found.sum())} of {len(usable)} "
            "frames, needed half; image a flat bare floor, or give the lines with --line-table"
        )
    return Trace(t_s[usable][lines.is_found], lines.row_px[lines.is_found])


def _line(image: FloatArray, center: float, rng: Generator) -> tuple[float, float] | None:
    """Find a line's row at the centre column and its slope, or None."""
    column, row, strength = _echoes(image)
    if len(column) < max(8, MIN_COLUMNS * image.shape[1]):
        return None
    pairs = rng.integers(0, len(column), size=(HYPOTHESES, 2))
    step = column[pairs[:, 1]] - column[pairs[:, 0]]
    pairs, step = pairs[np.abs(step) > 0.05 * image.shape[1]], step[np.abs(step) > 0.05 * image.shape[1]]
    if len(step) == 0:
        return None
    slopes = (row[pairs[:, 1]] - row[pairs[:, 0]]) / step
    at_center = row[pairs[:, 0]] + slopes * (center - column[pairs[:, 0]])
    residuals = np.abs(row - at_center[:, None] - slopes[:, None] * (column - center))
    best = int(np.minimum(residuals, TOLERANCE_PX).sum(axis=1).argmin())
    near = residuals[best] <= TOLERANCE_PX
    if near.mean() < MIN_SUPPORT:
        return None
    for _ in range(3):
        slope, offset = np.polyfit(column[near] - center, row[near], 1, w=np.sqrt(strength[near]))
        near = np.abs(row - offset - slope * (column - center)) <= TOLERANCE_PX
        if near.sum() < 8:
            return None
    if abs(np.degrees(np.arctan(slope))) > MAX_SLOPE_DEG:
        return None
    return float(offset), float(slope)


def _echoes(image: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Column, sub-pixel row and strength of the brightest echo of each bright column."""
    top = image.argmax(axis=0)
    strength = image.max(axis=0)
    bright = strength >= max(MIN_CONTRAST, BRIGHT_SHARE * float(strength.max()))
    columns = np.flatnonzero(bright)
    offsets = np.arange(-6, 7)
    rows = np.clip(top[columns, None] + offsets, 0, image.shape[0] - 1)
    weight = np.clip(image[rows, columns[:, None]], 0, None)
    center = (rows * weight).sum(axis=1) / weight.sum(axis=1)
    return columns.astype(np.float64), center, strength[columns]
