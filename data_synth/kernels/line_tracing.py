"""Straight interpolation along traced scan lines."""

from dvf_ig.core import AnyArray

from .compiled import kernel


@kernel(nogil=True, error_model="numpy")
def fill_middles(path: AnyArray, stride: int) -> None:
    """Put the point half-way between every `stride`-th point of (lines, count, 3) paths into their middle."""
    half = stride // 2
    for line in range(path.shape[0]):
        for i in range(0, path.shape[1] - stride, stride):
            for k in range(3):
                path[line, i + half, k] = 0.5 * (path[line, i, k] + path[line, i + stride, k])
