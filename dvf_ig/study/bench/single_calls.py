"""Kernels that only the benchmark calls, one point a call: the static distance, and nothing at all."""

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import kernel
from dvf_ig.kernels.spline import spline_at


@kernel
def spline_tick(
    coefficients: NDArray[np.float32], box: FloatArray, phase: int, xyz_mm: FloatArray, out: FloatArray
) -> int:
    """Distance and gradient of one phase at one point.

    Args:
        coefficients: (n, cx, cy, cz) mm.
        box: (4,) origin in mm, knot pitch in mm.
        phase: index of the phase, not checked.
        xyz_mm: (3,) point in the model's frame.
        out: (4,) distance in mm and its gradient; NaN unless the status is OK.
    Returns:
        status code.
    """
    q = (xyz_mm[0], xyz_mm[1], xyz_mm[2])
    status, out[0], out[1], out[2], out[3] = spline_at(coefficients, box, 1.0 / box[3], phase, q)
    return status


@kernel
def no_operation(number: int) -> int:
    """What a call from Python costs at the least."""
    return number
