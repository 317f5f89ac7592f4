"""Reference positions along scan lines: exact at creases of the motion, straight between them."""

import numpy as np
from numpy.typing import NDArray

from data_synth.heart.motion import PullBack
from data_synth.kernels.line_tracing import fill_middles
from dvf_ig.core import FloatArray, InvalidInputError

COARSE = 8
TOLERANCE_MM = 0.03


def traced_lines(motion: PullBack, points_mm: FloatArray, phases: FloatArray) -> FloatArray:
    """Trace (lines, count, 3) reference positions of points along smooth lines, to TOLERANCE_MM.

    Every COARSE-th point is pulled back. Straight lines connect them, unless second differences show that
    the path bends: there the intervals are halved until they are straight or one step long.

    Args:
        points_mm: (lines, count, 3) evenly spaced along each line, count a multiple of COARSE, plus 1.
        phases: (lines,) model phase of each.
    Raises:
        InvalidInputError: another count.
    """
    count = points_mm.shape[1]
    if count < 2 * COARSE + 1 or count % COARSE != 1:
        raise InvalidInputError(
            f"lines have {count} points; needed a multiple of {COARSE}, plus 1, at least {2 * COARSE + 1}"
        )
    path = np.empty(points_mm.shape)
    nodes = points_mm[:, ::COARSE]
    times = np.repeat(phases, nodes.shape[1])
    path[:, ::COARSE] = motion.pull_back(nodes.reshape(-1, 3), times).reshape(nodes.shape)
    line, interval = np.nonzero(_bent(path[:, ::COARSE]))
    node, stride = interval * COARSE, COARSE
    while stride > 1:
        half = stride // 2
        fill_middles(path, stride)
        middle = node + half
        traced = motion.pull_back(points_mm[line, middle], phases[line])
        missed = ((traced - path[line, middle]) ** 2).sum(axis=1) > (0.5 * TOLERANCE_MM) ** 2
        path[line, middle] = traced
        line, node = np.repeat(line[missed], 2), np.repeat(node[missed], 2)
        node[1::2] += half
        stride = half
    return path


def _bent(nodes_mm: FloatArray) -> NDArray[np.bool_]:
    """Flag (lines, intervals) in which a crease could make the chord miss by TOLERANCE_MM.

    A crease at fraction f of an interval shows as a share 1 − f and f of its bend in the second differences
    at either end, and the chord misses it by f(1 − f) of the bend: by their product over their sum.
    """
    second = nodes_mm[:, 2:] - 2.0 * nodes_mm[:, 1:-1] + nodes_mm[:, :-2]
    bend = np.sqrt((second**2).sum(axis=2))
    # outside the ends of the line anything is possible
    bend = np.pad(bend, ((0, 0), (1, 1)), constant_values=1e9)
    left, right = bend[:, :-1], bend[:, 1:]
    return np.asarray(left * right > TOLERANCE_MM * (left + right))
