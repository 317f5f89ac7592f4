"""Sums over square blocks of B-mode images, which average out the speckle."""

import numpy as np
from numpy.typing import NDArray

from dvf_ig.kernels.compiled import kernel


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
