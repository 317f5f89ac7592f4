"""A small still heart for registration tests: nested ellipsoids as MR, and slices cut from them."""

from functools import cache

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from dvf_ig.core import CycleTiming, FloatArray, Grid, Rigid, VolumeSeries
from dvf_ig.registration import SliceSet

CENTER_MM = np.array([20.0, -10.0, 40.0])


@cache
def toy_mr(blood: float = 300.0, wall: float = 100.0, outside: float = 160.0) -> VolumeSeries:
    """Three blood pools in a wall, 2 mm voxels, two identical phases."""
    shape = (70, 64, 60)
    grid = Grid.axis_aligned("mr", shape, CENTER_MM - np.array(shape) + 1, 2.0)
    q = grid.centers_mm() - CENTER_MM
    values = np.full(shape, outside)
    values[_inside(q, (0, 0, 0), (48, 40, 44))] = wall
    for center, radii in (
        ((-14, 4, -8), (16, 14, 26)),
        ((20, -8, -6), (14, 20, 22)),
        ((4, 6, 26), (22, 16, 9)),
    ):
        values[_inside(q, center, radii)] = blood
    values = ndimage.gaussian_filter(values, 0.5)
    return VolumeSeries(grid, np.stack([values, values]), CycleTiming.uniform(2, 0.8))


def _inside(q: FloatArray, center: tuple[float, ...], radii: tuple[float, ...]) -> FloatArray:
    return np.asarray((((q - center) / radii) ** 2).sum(axis=-1) < 1)


def toy_pose() -> Rigid:
    return Rigid.from_rotation_vector([0.4, -0.7, 0.3], [60.0, -30.0, 12.0], "mr", "tracker")


def toy_slices(
    mr: VolumeSeries, mr_from_tracker: Rigid, rng: np.random.Generator, *, pitch_mm: float, speckle: float
) -> SliceSet:
    """Slices through the heart with inverted contrast and multiplicative speckle."""
    count, size = 12, int(130 / pitch_mm)
    tracker_from_mr = mr_from_tracker.inverse()
    images, maps = [], []
    for k in range(count):
        turn = Rotation.from_euler("yx", [k * 180 / count, 25 * np.sin(k)], degrees=True).as_matrix()
        corner = CENTER_MM + rng.normal(0, 6, 3) - turn @ np.array([65.0, 65.0, 0.0])
        mr_from_pixel = np.column_stack([turn[:, 0] * pitch_mm, turn[:, 1] * pitch_mm, corner])
        row, col = np.mgrid[:size, :size]
        points = np.stack([col, row, np.ones_like(row)], -1) @ mr_from_pixel.T
        sampled = ndimage.map_coordinates(
            mr.values[0], np.moveaxis(mr.grid.to_index(points), -1, 0), order=1, mode="nearest"
        )
        echo = 1.2 - sampled / 300.0
        images.append(echo * np.clip(1 + speckle * rng.normal(size=echo.shape), 0.1, None))
        to_tracker = tracker_from_mr.rotation @ mr_from_pixel
        to_tracker[:, 2] += tracker_from_mr.translation_mm
        maps.append(to_tracker)
    stack = np.stack(images).astype(np.float32)
    zeros = np.zeros(count)
    return SliceSet("tracker", stack, np.ones(stack.shape, dtype=np.bool_), np.stack(maps), zeros, zeros)
