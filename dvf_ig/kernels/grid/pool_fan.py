"""Averages of the insonified voxels in blocks of an image: gaps that no frame reached do not count."""

import numpy as np
from numpy.typing import NDArray

from dvf_ig.kernels.compiled import kernel


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
