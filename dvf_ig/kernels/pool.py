"""Averages of blocks of voxels, of what a table says of their grey levels."""

import numpy as np
from numpy.typing import NDArray

from .compiled import kernel


@kernel
def pool_blocks(
    grey: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    table: NDArray[np.float32],
    step: int,
    out: NDArray[np.float32],
) -> None:
    """Mean of `table[grey]` over each block of step³ voxels; NaN where one of them lies outside the mask.

    Args:
        grey, mask: (nx, ny, nz).
        table: (256,).
        out: (nx // step, ny // step, nz // step).
    """
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            for k in range(out.shape[2]):
                total = np.float32(0.0)
                whole = True
                for a in range(i * step, (i + 1) * step):
                    for b in range(j * step, (j + 1) * step):
                        for c in range(k * step, (k + 1) * step):
                            whole = whole and mask[a, b, c] != 0
                            total += table[grey[a, b, c]]
                out[i, j, k] = total / np.float32(step * step * step) if whole else np.nan
