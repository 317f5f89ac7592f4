"""Moments of the ultrasound over square windows: running sums over the runs of its slices (see `slices`)."""

import numpy as np
from numpy.typing import NDArray

from dvf_ig.kernels.compiled import kernel

from .slices import FIRST, LAST, PIXEL, ROW, Floats, Ints


@kernel
def window_moments(
    pixels: NDArray[np.float32],
    first_run: Ints,
    runs: Ints,
    radius: int,
    first_center: Ints,
    centers: Ints,
    columns: Floats,
    out: Floats,
) -> None:
    """Compute pixel count, mean and variance over the window about every centre.

    Args:
        pixels, first_run, runs: as in `slices.PatchedSlices`.
        first_center: (s + 1,) start of each slice's centres; centers: (p, 2) row and column, by rows.
        columns: (columns + 2·radius, 3) scratch.
        out: (p, 3).
    """
    for s in range(len(first_run) - 1):
        first, end = first_run[s], first_run[s + 1]
        if first == end:
            continue
        columns[:] = 0.0
        added = dropped = first
        for p in range(first_center[s], first_center[s + 1]):
            row = centers[p, 0]
            while added < end and runs[added, ROW] <= row + radius:
                _add_run(pixels, runs[added], radius, 1.0, columns)
                added += 1
            while dropped < added and runs[dropped, ROW] < row - radius:
                _add_run(pixels, runs[dropped], radius, -1.0, columns)
                dropped += 1
            count = total = squares = 0.0
            for c in range(centers[p, 1], centers[p, 1] + 2 * radius + 1):
                count += columns[c, 0]
                total += columns[c, 1]
                squares += columns[c, 2]
            mean = total / count
            out[p, 0], out[p, 1], out[p, 2] = count, mean, squares / count - mean * mean


@kernel
def _add_run(pixels: NDArray[np.float32], run: Ints, radius: int, sign: float, columns: Floats) -> None:
    """Add a run's pixels to its columns, or subtract them."""
    for k in range(run[LAST] - run[FIRST]):
        u, column = float(pixels[run[PIXEL] + k]), run[FIRST] + k + radius
        columns[column, 0] += sign
        columns[column, 1] += sign * u
        columns[column, 2] += sign * u * u
