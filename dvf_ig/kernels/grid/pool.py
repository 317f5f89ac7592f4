"""Averages over blocks: of voxels, of the insonified voxels of an image, of squares of B-mode frames."""

import math
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from dvf_ig.kernels.compiled import inlined, kernel

Corner = tuple[int, int, int]
"""First voxel of a block."""


@inlined
def on_a_plane(i: int, j: int, k: int, every: int) -> bool:
    """Return whether a block is on a sampled plane: every `every`-th along an axis, from half of it on."""
    half = every // 2
    return i % every == half or j % every == half or k % every == half


@inlined
def _block_sum(grey: NDArray[np.uint8], mask: NDArray[np.uint8], low: Corner, step: int) -> np.float32:
    """Sum `grey` over one block; NaN if a voxel is outside the mask."""
    total = np.float32(0.0)
    for a in range(low[0], low[0] + step):
        for b in range(low[1], low[1] + step):
            for c in range(low[2], low[2] + step):
                if mask[a, b, c] == 0:
                    return np.float32(math.nan)
                total += np.float32(grey[a, b, c])
    return total


@kernel
def pool_blocks(
    grey: NDArray[np.uint8], mask: NDArray[np.uint8], step: int, every: int, out: NDArray[np.float32]
) -> None:
    """Average `grey` over each block of step³ voxels; NaN if one of them is outside the mask.

    Args:
        grey, mask: (nx, ny, nz).
        every: as in `on_a_plane`; NaN elsewhere.
        out: (nx // step, ny // step, nz // step).
    """
    count = np.float32(step * step * step)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            for k in range(out.shape[2]):
                out[i, j, k] = np.nan
                if on_a_plane(i, j, k, every):
                    low = (i * step, j * step, k * step)
                    out[i, j, k] = _block_sum(grey, mask, low, step) / count


@kernel
def pool_cubes(
    grey: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    edge: NDArray[np.float64],
    every: int,
    out: NDArray[np.float32],
) -> None:
    """Average `grey` over boxes of any size, each voxel weighted by its share inside; NaN as above.

    Args:
        grey, mask: (nx, ny, nz).
        edge: (3,) of a box in voxels along each axis; a multiple of one voxel may be off by rounding.
        every: as in `on_a_plane`; NaN elsewhere.
        out: (mx, my, mz), with m·edge at most n along each axis. Box i lies between i·edge and (i + 1)·edge,
            voxel j between j and j + 1.
    """
    least = 1e-6  # of a voxel: a smaller share is rounding
    for i in range(out.shape[0]):
        x0, x1 = i * edge[0], (i + 1) * edge[0]
        for j in range(out.shape[1]):
            y0, y1 = j * edge[1], (j + 1) * edge[1]
            for k in range(out.shape[2]):
                out[i, j, k] = np.nan
                if not on_a_plane(i, j, k, every):
                    continue
                z0, z1 = k * edge[2], (k + 1) * edge[2]
                total = 0.0
                whole = True
                for a in range(floor(x0 + least), ceil(x1 - least)):
                    wx = min(x1, a + 1.0) - max(x0, float(a))
                    for b in range(floor(y0 + least), ceil(y1 - least)):
                        wy = wx * (min(y1, b + 1.0) - max(y0, float(b)))
                        for c in range(floor(z0 + least), ceil(z1 - least)):
                            whole = whole and mask[a, b, c] != 0
                            total += wy * (min(z1, c + 1.0) - max(z0, float(c))) * grey[a, b, c]
                if whole:
                    out[i, j, k] = total / (edge[0] * edge[1] * edge[2])


@kernel
def pool_insonified(
    values: NDArray[np.float32],
    insonified: NDArray[np.bool_],
    step: NDArray[np.int64],
    mean: NDArray[np.float32],
    share: NDArray[np.float32],
) -> None:
    """Average the insonified voxels of every block, with their share of it.

    Args:
        values, insonified: (nx, ny, nz).
        step: (3,) voxels of a block along each axis.
        mean: (nx // step[0], ny // step[1], nz // step[2]) out, 0 if none is insonified; share: same shape.
    """
    size = 1.0 / (step[0] * step[1] * step[2])
    for i in range(mean.shape[0]):
        for j in range(mean.shape[1]):
            for k in range(mean.shape[2]):
                total, count = 0.0, 0
                for a in range(i * step[0], (i + 1) * step[0]):
                    for b in range(j * step[1], (j + 1) * step[1]):
                        for c in range(k * step[2], (k + 1) * step[2]):
                            if insonified[a, b, c]:
                                total += values[a, b, c]
                                count += 1
                mean[i, j, k] = total / max(count, 1)
                share[i, j, k] = count * size


@kernel
def block_sums(
    images: NDArray[np.uint8],
    mask: NDArray[np.bool_],
    lit_above: int,
    sums: NDArray[np.int64],
    lit: NDArray[np.int64],
) -> None:
    """Add up the grey levels of every block, and count bright pixels.

    Args:
        images: (n, rows, columns); mask: (rows, columns), pixels that count.
        lit_above: grey level above which a pixel is bright.
        sums: (n, block rows, block columns) out; blocks are rows // block rows high and columns // block
            columns wide, from the first pixel on; the remainder counts in none.
        lit: (n,) out, bright pixels of the mask within the blocks.
    """
    high, wide = images.shape[1] // sums.shape[1], images.shape[2] // sums.shape[2]
    for s in range(images.shape[0]):
        bright = 0
        for i in range(sums.shape[1]):
            for j in range(sums.shape[2]):
                total = 0
                for r in range(i * high, (i + 1) * high):
                    for c in range(j * wide, (j + 1) * wide):
                        grey = images[s, r, c] if mask[r, c] else 0
                        total += grey
                        bright += grey > lit_above
                sums[s, i, j] = total
        lit[s] = bright
