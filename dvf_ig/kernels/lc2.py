"""LC2: local linear combination of two channels, evaluated on tracked slices (Fuerst 2014; Wein 2013).

In each square patch of a slice the ultrasound u is fitted by α·a + β·b + γ, where a and b are two channels of
the model at that place (MR intensity and gradient magnitude, or blood and wall maps). The patch scores
S = 1 − Var(residual)/Var(u), the slice the weighted mean of S.

Window sums come from integral images, so the cost does not depend on the patch size; the seven sums of a
pixel lie side by side, so a window costs four cache lines. What depends on u alone is computed once per slice
set. Each slice writes its own results: they are the same at any thread count.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compiled import inlined, kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

A, B, AA, BB, AB, UA, UB = range(7)
"""Columns of the sums over a window: a, b, a², b², ab, ua, ub."""
SUMS = 7
INVERSE_COUNT, MEAN_U, VAR_U, WEIGHT = range(4)
"""Columns of the moments of a patch that depend on the ultrasound alone."""
SLICE_SCORE, SLICE_WEIGHT, SLICE_OVERLAP = range(3)
"""Columns of what `lc2_slices` says of a slice: Σ w·S, Σ w, share of its pixels inside the volume."""
RIDGE = 1e-4
"""Added to both channel variances; the channels are scaled to unit variance over the model's volume."""


class PatchedSlices(NamedTuple):
    """Ultrasound slices and their patches.

    Attributes:
        images: (s, rows, columns) float32, 0 outside the mask; masks: (s, rows, columns).
        first_patch: (s + 1,) where each slice's patches begin.
        boxes: (p, 4) first row, last row + 1, first column, last column + 1.
        moments: (p, 4) one over the pixel count, mean and variance of u, and weight.
    """

    images: NDArray[np.float32]
    masks: Bools
    first_patch: Ints
    boxes: Ints
    moments: Floats


class PlacedModel(NamedTuple):
    """The model at a pose.

    Attributes:
        channels: (n, nx, ny, nz, 2) float32.
        phases: (s,) which of the n volumes each slice is compared with.
        index_from_pixel: (s, 3, 3) voxel index from (column, row, 1).
    """

    channels: NDArray[np.float32]
    phases: Ints
    index_from_pixel: Floats


@inlined
def _axis_cell(x: float, last: float) -> tuple[int, float, bool]:
    """Voxel below x along one axis, the fraction beyond it, and whether x lies in [0, last].

    Beyond the volume its border value goes on; the far border belongs to the last cell.
    """
    inside = 0.0 <= x <= last
    x = min(max(x, 0.0), last)
    i = min(int(x), int(last) - 1)
    return i, x - i, inside


@inlined
def volume_cell(
    shape: Any, matrix: Floats, row: int, column: int
) -> tuple[tuple[int, int, int], tuple[float, float, float], tuple[bool, bool, bool]]:
    """Cell of a volume that a pixel falls into: lowest voxel, fractions beyond it, inside along each axis.

    Args:
        shape: (nx, ny, nz, …) of the volume.
        matrix: (3, 3) voxel index from (column, row, 1).
    """
    i, fx, in_x = _axis_cell(matrix[0, 0] * column + matrix[0, 1] * row + matrix[0, 2], shape[0] - 1.0)
    j, fy, in_y = _axis_cell(matrix[1, 0] * column + matrix[1, 1] * row + matrix[1, 2], shape[1] - 1.0)
    k, fz, in_z = _axis_cell(matrix[2, 0] * column + matrix[2, 1] * row + matrix[2, 2], shape[2] - 1.0)
    return (i, j, k), (fx, fy, fz), (in_x, in_y, in_z)


@kernel
def sample_channels(
    channels: NDArray[np.float32], phase: int, matrix: Floats, mask: Bools, out: Floats
) -> float:
    """Trilinear values of both channels at every masked pixel of one slice.

    Args:
        channels: (n, nx, ny, nz, 2) float32.
        phase: which of the n volumes.
        matrix: (3, 3) voxel index from (column, row, 1).
        mask: (rows, columns).
        out: (rows, columns, 2) filled with values, 0 outside the mask; the border value outside the volume.
    Returns:
        share of masked pixels that lie inside the volume.
    """
    volume = channels[phase]
    inside = 0
    total = 0
    for r in range(mask.shape[0]):
        for c in range(mask.shape[1]):
            if not mask[r, c]:
                out[r, c, 0] = 0.0
                out[r, c, 1] = 0.0
                continue
            total += 1
            (i, j, k), (fx, fy, fz), (in_x, in_y, in_z) = volume_cell(volume.shape, matrix, r, c)
            if in_x and in_y and in_z:
                inside += 1
            w11, w10, w01, w00 = fx * fy, fx * (1 - fy), (1 - fx) * fy, (1 - fx) * (1 - fy)
            for ch in range(2):
                low = (
                    w00 * volume[i, j, k, ch]
                    + w01 * volume[i, j + 1, k, ch]
                    + w10 * volume[i + 1, j, k, ch]
                    + w11 * volume[i + 1, j + 1, k, ch]
                )
                high = (
                    w00 * volume[i, j, k + 1, ch]
                    + w01 * volume[i, j + 1, k + 1, ch]
                    + w10 * volume[i + 1, j, k + 1, ch]
                    + w11 * volume[i + 1, j + 1, k + 1, ch]
                )
                out[r, c, ch] = low + fz * (high - low)
    return inside / max(total, 1)


@kernel
def integrate_products(image: NDArray[np.float32], values: Floats, table: Floats) -> None:
    """Integral images of the seven sums, (rows + 1, columns + 1, 7), first row and column zero.

    Args:
        image: (rows, columns) ultrasound; values: (rows, columns, 2) channels; all 0 outside the mask.
    """
    rows, cols = image.shape
    for c in range(cols + 1):
        for q in range(SUMS):
            table[0, c, q] = 0.0
    for r in range(1, rows + 1):
        sa = sb = saa = sbb = sab = sua = sub = 0.0
        for q in range(SUMS):
            table[r, 0, q] = 0.0
        for c in range(1, cols + 1):
            u, a, b = image[r - 1, c - 1], values[r - 1, c - 1, 0], values[r - 1, c - 1, 1]
            sa += a
            sb += b
            saa += a * a
            sbb += b * b
            sab += a * b
            sua += u * a
            sub += u * b
            table[r, c, A] = table[r - 1, c, A] + sa
            table[r, c, B] = table[r - 1, c, B] + sb
            table[r, c, AA] = table[r - 1, c, AA] + saa
            table[r, c, BB] = table[r - 1, c, BB] + sbb
            table[r, c, AB] = table[r - 1, c, AB] + sab
            table[r, c, UA] = table[r - 1, c, UA] + sua
            table[r, c, UB] = table[r - 1, c, UB] + sub


@inlined
def window_mean(table: Floats, box: Any, q: int, inverse_count: float) -> float:
    """Mean of sum `q` over the window (first row, last row + 1, first column, last column + 1)."""
    r0, r1, c0, c1 = box
    total = table[r1, c1, q] - table[r0, c1, q] - table[r1, c0, q] + table[r0, c0, q]
    return float(total * inverse_count)


@inlined
def patch_moments(
    table: Floats, box: Any, inverse_count: float, mean_u: float
) -> tuple[float, float, float, float, float, float, float]:
    """Of one patch: means of a and b, ridged variances and covariance, and covariances with u."""
    a = window_mean(table, box, A, inverse_count)
    b = window_mean(table, box, B, inverse_count)
    aa = window_mean(table, box, AA, inverse_count) - a * a + RIDGE
    bb = window_mean(table, box, BB, inverse_count) - b * b + RIDGE
    ab = window_mean(table, box, AB, inverse_count) - a * b
    ua = window_mean(table, box, UA, inverse_count) - mean_u * a
    ub = window_mean(table, box, UB, inverse_count) - mean_u * b
    return a, b, aa, bb, ab, ua, ub


@kernel
def explained_share(table: Floats, box: Any, inverse_count: float, mean_u: float, var_u: float) -> float:
    """S of one patch: the share of u's variance that the best α·a + β·b + γ explains."""
    _, _, aa, bb, ab, ua, ub = patch_moments(table, box, inverse_count, mean_u)
    explained = (ua * ua * bb - 2.0 * ua * ub * ab + ub * ub * aa) / (aa * bb - ab * ab)
    return min(max(explained / var_u, 0.0), 1.0)


@inlined
def box_of(boxes: Ints, p: int) -> tuple[int, int, int, int]:
    """Window of patch `p`."""
    return boxes[p, 0], boxes[p, 1], boxes[p, 2], boxes[p, 3]


@kernel
def lc2_slices(
    slices: PatchedSlices,
    model: PlacedModel,
    values: Floats,
    tables: Floats,
    out: Floats,
    begin: int,
    end: int,
) -> None:
    """Score slices begin <= s < end; see the module docstring. Several ranges may run at once.

    Args:
        values: (s, rows, columns, 2) scratch; tables: (s, rows + 1, columns + 1, SUMS) scratch.
        out: (s, 3) filled with SLICE_SCORE, SLICE_WEIGHT and SLICE_OVERLAP.
    """
    moments = slices.moments
    for s in range(begin, end):
        out[s, SLICE_OVERLAP] = sample_channels(
            model.channels, model.phases[s], model.index_from_pixel[s], slices.masks[s], values[s]
        )
        integrate_products(slices.images[s], values[s], tables[s])
        score = 0.0
        weight = 0.0
        for p in range(slices.first_patch[s], slices.first_patch[s + 1]):
            w = moments[p, WEIGHT]
            score += w * explained_share(
                tables[s],
                box_of(slices.boxes, p),
                moments[p, INVERSE_COUNT],
                moments[p, MEAN_U],
                moments[p, VAR_U],
            )
            weight += w
        out[s, SLICE_SCORE] = score
        out[s, SLICE_WEIGHT] = weight
