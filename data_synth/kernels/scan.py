"""Scan conversion: from samples along scan lines to pixels and voxels."""

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel


@kernel(nogil=True, error_model="numpy")
def scan_convert(grey: AnyArray, line_index: AnyArray, sample_index: AnyArray, out: AnyArray) -> None:
    """Interpolate (lines, samples) bilinearly to pixels; pixels with a negative line index become 0."""
    lines, samples = grey.shape
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            p = line_index[row, column]
            if p < 0.0:
                out[row, column] = 0
                continue
            q = sample_index[row, column]
            a, b = min(int(p), lines - 2), min(int(q), samples - 2)
            f, g = p - a, q - b
            value = (1.0 - f) * ((1.0 - g) * grey[a, b] + g * grey[a, b + 1]) + f * (
                (1.0 - g) * grey[a + 1, b] + g * grey[a + 1, b + 1]
            )
            out[row, column] = np.uint8(value + 0.5)


@kernel(nogil=True, error_model="numpy")
def scan_convert_slab(
    grey: AnyArray,
    start: int,
    stop: int,
    spacing_mm: float,
    first_mm: AnyArray,
    half_angles: AnyArray,
    step_mm: float,
    out: AnyArray,
    mask: AnyArray,
) -> None:
    """Interpolate a pyramid (elevation lines, lateral lines, samples) trilinearly to voxels.

    Voxels start <= i < stop along the first axis of `out` (lateral, depth, elevation), in the probe's plane
    frame; the two line angles are atan(lateral/depth) and atan(elevation/depth).
    """
    tall, wide, samples = grey.shape
    for i in range(start, stop):
        x = first_mm[0] + i * spacing_mm
        for j in range(out.shape[1]):
            y = max(first_mm[1] + j * spacing_mm, 1e-6)
            p = (np.arctan(x / y) / half_angles[0] + 1.0) * 0.5 * (wide - 1)
            for k in range(out.shape[2]):
                z = first_mm[2] + k * spacing_mm
                s = (np.arctan(z / y) / half_angles[1] + 1.0) * 0.5 * (tall - 1)
                q = np.sqrt(x * x + y * y + z * z) / step_mm - 0.5
                if p < 0.0 or p > wide - 1 or s < 0.0 or s > tall - 1 or q > samples - 0.5:
                    out[i, j, k], mask[i, j, k] = 0, 0
                    continue
                q = min(max(q, 0.0), samples - 1.0)
                a, b, c = min(int(s), tall - 2), min(int(p), wide - 2), min(int(q), samples - 2)
                value = 0.0
                for n in range(8):
                    u, v, w = n >> 2, (n >> 1) & 1, n & 1
                    share = (s - a if u else 1.0 - s + a) * (p - b if v else 1.0 - p + b)
                    value += share * (q - c if w else 1.0 - q + c) * grey[a + u, b + v, c + w]
                out[i, j, k], mask[i, j, k] = np.uint8(value + 0.5), 1
