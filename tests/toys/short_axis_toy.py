"""A short-axis cine whose motion is known in closed form: a left ventricle that tapers towards its apex."""

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import CycleTiming, FloatArray, Grid, VolumeSeries

PIXEL_MM, PITCH_MM, SLICES, PIXELS = 1.5, 10.0, 5, 44
SCALES = (1.0, 0.93, 0.84, 0.78, 0.86, 0.95)
WALL, CAVITY = 1, 2


def contracting_stack(
    scales: tuple[float, ...] = SCALES, *, noise: float = 0.03
) -> tuple[VolumeSeries, NDArray[np.uint8]]:
    """Grey levels and labels: the cavity scales by `scales`, the wall keeps its area.

    The stack ends within the ventricle at both ends, as the labelled slices of many cines do.
    """
    spacing = np.array([PIXEL_MM, PIXEL_MM, PITCH_MM])
    grid = Grid.axis_aligned("mr", (PIXELS, PIXELS, SLICES), np.zeros(3), spacing)
    center_mm = 0.5 * PIXEL_MM * (PIXELS - 1)
    at = grid.centers_mm()
    across = at[..., :2] - center_mm
    inner_mm = 15.0 - 0.15 * at[..., 2]
    rng = np.random.default_rng(7)
    grey, labels = [], []
    for scale in scales:
        edges_mm = (inner_mm * scale, np.sqrt((inner_mm * scale) ** 2 + 17.0**2 - 6.0 * inner_mm))
        values, codes = _slices(across, edges_mm, at[..., 2])
        grey.append(values + noise * rng.standard_normal(values.shape))
        labels.append(codes)
    return VolumeSeries(grid, np.stack(grey), CycleTiming.uniform(len(scales), 0.9)), np.stack(labels)


def _slices(
    across_mm: FloatArray, edges_mm: tuple[FloatArray, FloatArray], z_mm: FloatArray
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Blood in muscle in lung, with a neighbour that stays where it is and changes from slice to slice."""
    radius = np.linalg.norm(across_mm, axis=-1)
    inner, outer = edges_mm
    values = 0.2 + 0.15 * np.sin(0.35 * across_mm[..., 0] + 0.25 * z_mm) * np.cos(0.3 * across_mm[..., 1])
    values += (0.5 - values) / (1 + np.exp((radius - outer) / 0.7))
    values += 0.5 / (1 + np.exp((radius - inner) / 0.7))
    return values, np.where(radius < inner, CAVITY, np.where(radius < outer, WALL, 0)).astype(np.uint8)
