"""Signed distance from foot points, against the same in array arithmetic."""

import numpy as np

from dvf_ig.kernels.boundary import foot_point_distance


def test_distance_from_foot_points_is_that_of_its_twin() -> None:
    rng = np.random.default_rng(2)
    shape, count, h, plane_mm = (4, 5, 6), 7, np.array([1.0, 1.5, 2.0]), 2.0
    places = np.stack(np.unravel_index(rng.permutation(120)[:count], shape))
    row = np.zeros(shape, dtype=np.int32)
    row[tuple(places)] = np.arange(count)
    chosen = rng.integers(0, count, shape)
    nearest = places[:, chosen].astype(np.int32)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    feet_mm, inside = 0.3 * normals, rng.random(shape) > 0.5
    out = np.empty(shape, dtype=np.float32)
    foot_point_distance(nearest, row, feet_mm, normals, inside, h, plane_mm, out)

    apart = (np.moveaxis(np.indices(shape) - nearest, 0, -1)) * h + feet_mm[chosen]
    plane = (apart * normals[chosen]).sum(axis=-1)
    length = np.linalg.norm(apart, axis=-1)
    far = np.clip((length / plane_mm - 1) / 2, 0, 1)
    expected = plane + far * (np.where(inside, length, -length) - plane)
    np.testing.assert_allclose(out, expected, atol=1e-6)
