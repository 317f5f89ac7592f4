"""LC2: local linear combination of two channels, evaluated on tracked slices (Fuerst 2014; Wein 2013).

In each square patch of a slice the ultrasound u is fitted by α·a + β·b + γ, where a and b are two channels of
the model at the same position (MR intensity and gradient magnitude, or blood and wall maps). The patch scores
S = 1 − Var(residual)/Var(u), the slice the weighted mean of S.

Only pixels of the sector are stored and visited, as runs along its rows. Sums over windows are running sums:
each column holds those of the window's rows, and loses a row as it gains the next. The seven sums of a pixel
are adjacent, as two rows of four (docs/decisions/0006). Terms of u alone are computed once per
slice set. Each slice writes its own results: they are the same at any thread count.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.lanes import (
    Float64x4,
    add,
    fma,
    load4,
    load_row,
    multiply,
    pack,
    pair_sums,
    prefetch_row,
    scale,
    store4,
    subtract,
    unpack,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROW, FIRST, LAST, PIXEL = range(4)
"""Columns of a run: its row, first column, last column + 1, number of its first pixel in the slice set."""
PATCH_ROW, PATCH_COLUMN = range(2)
INVERSE_COUNT, MEAN_U, VAR_U, WEIGHT = range(4)
"""Columns of a patch's moments that depend only on the ultrasound."""
SLICE_SCORE, SLICE_WEIGHT, SLICE_OVERLAP = range(3)
"""Columns of a slice's result from `lc2_slices`: Σ w·S, Σ w, share of its pixels inside the volume."""
RIDGE = 1e-4
"""Added to both channel variances; the channels are scaled to unit variance over the model's volume."""
SUMS = 8
"""Count of numbers for a pixel, a column and a patch; two rows of four."""
CENTER_STEP = 2
"""Pitch of the patches' centres in pixels and rows: neighbours share nearly all their pixels."""


class PatchedSlices(NamedTuple):
    """Ultrasound slices and their patches.

    Attributes:
        pixels: (n,) float32 ultrasound, run after run.
        first_run: (s + 1,) start of each slice's runs; runs: (k, 4), by rows.
        first_patch: (s + 1,) start of each slice's patches.
        centers: (p, 2) row and column, both even, by rows.
        moments: (p, 4) one over the pixel count, mean and variance of u, and weight.
        radius: of a patch of (2·radius + 1)² pixels.
    """

    pixels: NDArray[np.float32]
    first_run: Ints
    runs: Ints
    first_patch: Ints
    centers: Ints
    moments: Floats
    radius: int


class PlacedModel(NamedTuple):
    """Model at a pose.

    Attributes:
        channels: (n, nx, ny, 2·nz) float32, both channels of a voxel side by side; nx, ny, nz >= 2.
        phases: (s,) index of the volume with which each slice is compared.
        index_from_pixel: (s, 3, 3) voxel index from (column, row, 1).
    """

    channels: NDArray[np.float32]
    phases: Ints
    index_from_pixel: Floats


class Scratch(NamedTuple):
    """Work space of the caller, one part for each worker.

    Attributes:
        samples: (workers, most pixels of a slice, SUMS): a, b, ∂x a, ∂x b, ∂y a, ∂y b, ∂z a, ∂z b per voxel.
        window: (workers, 2·radius + 1, columns + 2·radius, SUMS): products of the rows that a window covers.
        columns: (workers, columns + 2·radius, SUMS).
        fits: (workers, most patches of a slice, SUMS): the terms of a patch's fit that its pixels need.
    """

    samples: Floats
    window: Floats
    columns: Floats
    fits: Floats


@inlined
def _axis_cell(x: float, last: float) -> tuple[int, float, bool]:
    """Find the voxel below x along one axis, the fraction beyond it, and whether x is in [0, last].

    Outside the volume its border value continues; the far border belongs to the last cell, NaN to the first.
    """
    inside = 0.0 <= x <= last
    x = x if x > 0.0 else 0.0
    x = x if x < last else last
    i = min(int(x), int(last) - 1)
    return i, x - i, inside


@inlined
def volume_cell(
    shape: Any, matrix: Floats, row: int, column: int
) -> tuple[tuple[int, int, int], tuple[float, float, float], tuple[bool, bool, bool]]:
    """Find the cell of a volume around a pixel: lowest voxel, fractions beyond it, inside along each axis.

    Args:
        shape: (nx, ny, 2·nz) of both channels.
        matrix: (3, 3) voxel index from (column, row, 1).
    """
    i, fx, in_x = _axis_cell(matrix[0, 0] * column + matrix[0, 1] * row + matrix[0, 2], shape[0] - 1.0)
    j, fy, in_y = _axis_cell(matrix[1, 0] * column + matrix[1, 1] * row + matrix[1, 2], shape[1] - 1.0)
    k, fz, in_z = _axis_cell(matrix[2, 0] * column + matrix[2, 1] * row + matrix[2, 2], 0.5 * shape[2] - 1.0)
    return (i, j, k), (fx, fy, fz), (in_x, in_y, in_z)


@inlined
def edge_rows(
    channels: NDArray[np.float32], phase: int, cell: tuple[int, int, int]
) -> tuple[Float64x4, Float64x4, Float64x4, Float64x4]:
    """Load (a, b) at both ends of each edge along z of a cell: at (x, y) = 00, 01, 10, 11."""
    p, i, j, k = np.uintp(phase), np.uintp(cell[0]), np.uintp(cell[1]), np.uintp(2 * cell[2])
    return (
        load_row(channels, p, i, j, k),
        load_row(channels, p, i, j + np.uintp(1), k),
        load_row(channels, p, i + np.uintp(1), j, k),
        load_row(channels, p, i + np.uintp(1), j + np.uintp(1), k),
    )


AHEAD = 6
"""Pixels along a row between prefetching a cell and reading it; 16 is slower."""


@inlined
def fetch_ahead(channels: NDArray[np.float32], phase: int, matrix: Floats, row: int, column: int) -> None:
    """Prefetch the cell of a pixel that is sampled soon: a volume is larger than the near caches."""
    cell, _, _ = volume_cell(channels.shape[1:], matrix, row, column)
    p, i, j, k = np.uintp(phase), np.uintp(cell[0]), np.uintp(cell[1]), np.uintp(2 * cell[2])
    prefetch_row(channels, p, i, j, k)
    prefetch_row(channels, p, i, j + np.uintp(1), k)
    prefetch_row(channels, p, i + np.uintp(1), j, k)
    prefetch_row(channels, p, i + np.uintp(1), j + np.uintp(1), k)


@kernel
def sample_channels(
    channels: NDArray[np.float32], phase: int, matrix: Floats, runs: Ints, samples: Floats
) -> int:
    """Interpolate both channels at every pixel of one slice; outside the volume the border value.

    Args:
        channels: (n, nx, ny, 2·nz) float32.
        phase: index of the volume.
        matrix: (3, 3) voxel index from (column, row, 1).
        runs: (k, 4) runs of the slice.
        samples: (pixels, SUMS) out: a, b.
    Returns:
        number of pixels inside the volume.
    """
    shape, first = channels.shape[1:], runs[0, PIXEL]
    inside = 0
    for run in range(len(runs)):
        row, begin, last = runs[run, ROW], runs[run, FIRST], runs[run, LAST]
        pixel = runs[run, PIXEL] - first
        for column in range(begin, last):
            fetch_ahead(channels, phase, matrix, row, min(column + AHEAD, last - 1))
            cell, (fx, fy, fz), (in_x, in_y, in_z) = volume_cell(shape, matrix, row, column)
            inside += in_x and in_y and in_z
            e00, e01, e10, e11 = edge_rows(channels, phase, cell)
            ends = scale((1.0 - fx) * (1.0 - fy), e00)
            ends = fma(fma(fma(ends, (1.0 - fx) * fy, e01), fx * (1.0 - fy), e10), fx * fy, e11)
            ends = multiply(ends, pack(1.0 - fz, 1.0 - fz, fz, fz))
            store4(samples, np.uintp(pixel + column - begin), np.uintp(0), pair_sums(ends, ends))
    return inside


@inlined
def _add_row(
    slices: PatchedSlices, run: int, first: int, samples: Floats, window: Floats, columns: Floats
) -> None:
    """Write a run's products to its row of the window, and add them to its columns."""
    pixels, radius, runs = slices.pixels, slices.radius, slices.runs
    row, begin, pixel = runs[run, ROW], runs[run, FIRST], runs[run, PIXEL]
    stored = window[row % (2 * radius + 1)]
    for column in range(begin, runs[run, LAST]):
        at, place = pixel + column - begin, np.uintp(column + radius)
        u, a, b = float(pixels[at]), samples[at - first, 0], samples[at - first, 1]
        low, high = pack(a, b, a * a, b * b), pack(a * b, u * a, u * b, 0.0)
        store4(stored, place, np.uintp(0), low)
        store4(stored, place, np.uintp(4), high)
        store4(columns, place, np.uintp(0), add(load4(columns, place, np.uintp(0)), low))
        store4(columns, place, np.uintp(4), add(load4(columns, place, np.uintp(4)), high))


@inlined
def _drop_row(slices: PatchedSlices, run: int, window: Floats, columns: Floats) -> None:
    """Subtract a run's products from its columns."""
    radius, runs = slices.radius, slices.runs
    stored = window[runs[run, ROW] % (2 * radius + 1)]
    for column in range(runs[run, FIRST], runs[run, LAST]):
        place = np.uintp(column + radius)
        for q in (np.uintp(0), np.uintp(4)):
            store4(columns, place, q, subtract(load4(columns, place, q), load4(stored, place, q)))


@inlined
def _fit_patch(slices: PatchedSlices, p: int, columns: Floats, fits: Floats, at: int) -> tuple[float, float]:
    """Fit a patch from the sums of its rows in the columns.

    Args:
        fits: row `at` is filled with c·α², c·αβ, c·β², c·α, c·β, c·αγ, c·βγ, w·S; c = w/(n·Var u).
    Returns:
        w·S and w.
    """
    begin = slices.centers[p, PATCH_COLUMN]
    low, high = load4(columns, np.uintp(begin), np.uintp(0)), load4(columns, np.uintp(begin), np.uintp(4))
    for k in range(begin + 1, begin + 2 * slices.radius + 1):
        low = add(low, load4(columns, np.uintp(k), np.uintp(0)))
        high = add(high, load4(columns, np.uintp(k), np.uintp(4)))
    inverse, mean_u = slices.moments[p, INVERSE_COUNT], slices.moments[p, MEAN_U]
    var_u, w = slices.moments[p, VAR_U], slices.moments[p, WEIGHT]
    a, b, aa, bb = unpack(scale(inverse, low))
    ab, ua, ub, _ = unpack(scale(inverse, high))
    aa, bb, ab = aa - a * a + RIDGE, bb - b * b + RIDGE, ab - a * b
    ua, ub = ua - mean_u * a, ub - mean_u * b
    per_determinant = 1.0 / (aa * bb - ab * ab)
    alpha, beta = (ua * bb - ub * ab) * per_determinant, (ub * aa - ua * ab) * per_determinant
    gamma = mean_u - alpha * a - beta * b
    per_variance = 1.0 / var_u
    c = w * inverse * per_variance
    ca, cb = c * alpha, c * beta
    store4(fits, np.uintp(at), np.uintp(0), pack(ca * alpha, ca * beta, cb * beta, ca))
    explained = w * min(max((alpha * ua + beta * ub) * per_variance, 0.0), 1.0)
    store4(fits, np.uintp(at), np.uintp(4), pack(cb, ca * gamma, cb * gamma, explained))
    return explained, w


@kernel
def fit_patches(
    slices: PatchedSlices, s: int, samples: Floats, window: Floats, columns: Floats, fits: Floats
) -> tuple[float, float]:
    """Fit all patches of slice `s`.

    Args:
        samples, window, columns, fits: one worker's part of `Scratch`.
    Returns:
        Σ w·S and Σ w.
    """
    runs, radius = slices.runs, slices.radius
    first, end = slices.first_run[s], slices.first_run[s + 1]
    patch, last_patch = slices.first_patch[s], slices.first_patch[s + 1]
    columns[:] = 0.0
    score, weight = 0.0, 0.0
    added = dropped = first
    for row in range(runs[first, ROW], runs[end - 1, ROW] + radius + 1):
        while dropped < end and runs[dropped, ROW] < row - 2 * radius:
            _drop_row(slices, dropped, window, columns)
            dropped += 1
        while added < end and runs[added, ROW] == row:
            _add_row(slices, added, runs[first, PIXEL], samples, window, columns)
            added += 1
        while patch < last_patch and slices.centers[patch, PATCH_ROW] == row - radius:
            explained, w = _fit_patch(slices, patch, columns, fits, patch - slices.first_patch[s])
            score += explained
            weight += w
            patch += 1
    return score, weight


@kernel
def lc2_slices(
    slices: PatchedSlices,
    model: PlacedModel,
    scratch: Scratch,
    out: Floats,
    worker: int,
    begin: int,
    end: int,
) -> None:
    """Score slices begin <= s < end; see the module docstring. Ranges may run in parallel.

    Args:
        out: (s, 3) filled with SLICE_SCORE, SLICE_WEIGHT and SLICE_OVERLAP.
        worker: index of the part of the scratch that is used.
    """
    samples, window = scratch.samples[worker], scratch.window[worker]
    columns, fits = scratch.columns[worker], scratch.fits[worker]
    for s in range(begin, end):
        runs = slices.runs[slices.first_run[s] : slices.first_run[s + 1]]
        out[s, :] = 0.0
        if len(runs) == 0:
            continue
        inside = sample_channels(model.channels, model.phases[s], model.index_from_pixel[s], runs, samples)
        pixels = runs[-1, PIXEL] + runs[-1, LAST] - runs[-1, FIRST] - runs[0, PIXEL]
        out[s, SLICE_OVERLAP] = inside / pixels
        out[s, SLICE_SCORE], out[s, SLICE_WEIGHT] = fit_patches(slices, s, samples, window, columns, fits)
