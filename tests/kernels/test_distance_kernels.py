"""Exact point-triangle distance and winding numbers, against closed forms and brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.kernels.mesh.closest import triangle_squared_distance
from dvf_ig.kernels.mesh.median_tree import split_at_medians
from dvf_ig.kernels.mesh.winding import winding_numbers
from dvf_ig.preop import build_triangle_tree

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def nearest_by_optimisation(corners, point):
    """Distance to a dense barycentric lattice on a triangle: an upper bound within its pitch."""
    s = np.linspace(0, 1, 201)
    u, v = np.meshgrid(s, s)
    keep = u + v <= 1
    lattice = (
        corners[0]
        + u[keep][:, None] * (corners[1] - corners[0])
        + v[keep][:, None] * (corners[2] - corners[0])
    )
    return np.linalg.norm(lattice - point, axis=1).min()


@given(seed=st.integers(0, 2**32 - 1))
def test_point_triangle_distance(seed):
    rng = np.random.default_rng(seed)
    corners, point = rng.normal(size=(3, 3)), 2 * rng.normal(size=3)
    got = np.sqrt(triangle_squared_distance(corners.reshape(1, 9), 0, *point))
    upper = nearest_by_optimisation(corners, point)
    pitch = np.linalg.norm(corners[1:] - corners[0], axis=1).sum() / 200
    assert upper - pitch <= got <= upper + 1e-12


@given(seed=st.integers(0, 2**32 - 1), collapse=st.sampled_from(["point", "edge", "line"]))
def test_triangles_without_area_give_no_nan(seed, collapse):
    rng = np.random.default_rng(seed)
    corners, point = rng.normal(size=(3, 3)), rng.normal(size=3)
    if collapse == "point":
        corners[1:] = corners[0]
    elif collapse == "edge":
        corners[1] = corners[0]
    else:
        corners[2] = 0.5 * (corners[0] + corners[1])
    squared = triangle_squared_distance(corners.reshape(1, 9), 0, *point)
    assert 0.0 <= squared <= max(((corners - point) ** 2).sum(axis=1)) + 1e-12


@pytest.mark.parametrize("count", [1, 3, 4, 5, 37, 500])
def test_tree_finds_what_brute_force_finds(count):
    rng = np.random.default_rng(count)
    corners = rng.normal(size=(count, 1, 3)) * 5 + rng.normal(size=(count, 3, 3))
    tree = build_triangle_tree(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    points = rng.normal(size=(200, 3)) * 8
    flat = corners.reshape(-1, 9)
    expected = [min(triangle_squared_distance(flat, m, *p) for m in range(count)) for p in points]
    np.testing.assert_allclose(tree.distance_mm(points), np.sqrt(expected), rtol=1e-12)


@pytest.mark.parametrize("collapse", ["point", "edge", "line", "beyond", "sliver"])
def test_leaves_with_triangles_without_area(collapse):
    """What `_fill_frame` makes of them is as far as the triangle itself."""
    rng = np.random.default_rng(8)
    corners = rng.normal(size=(24, 3, 3))
    if collapse == "point":
        corners[:, 1:] = corners[:, :1]
    elif collapse == "edge":
        corners[:, 1] = corners[:, 0]
    elif collapse == "line":
        corners[:, 2] = 0.3 * corners[:, 0] + 0.7 * corners[:, 1]
    elif collapse == "beyond":
        corners[:, 2] = 2.0 * corners[:, 1] - corners[:, 0]
    else:
        corners[:, 2] = corners[:, 1] + 1e-7 * rng.normal(size=(24, 3))
    tree = build_triangle_tree(corners.reshape(-1, 3), np.arange(72).reshape(-1, 3))
    points = 2.0 * rng.normal(size=(100, 3))
    sides = [(corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]) for k in range(3)]
    expected = []
    for p in points:
        squares = []
        for a, side in sides:
            length = np.maximum((side**2).sum(axis=1), 1e-300)
            t = np.clip(((p - a) * side).sum(axis=1) / length, 0.0, 1.0)
            squares.append(((a + t[:, None] * side - p) ** 2).sum(axis=1))
        expected.append(np.sqrt(np.min(squares)))
    np.testing.assert_allclose(tree.distance_mm(points), expected, atol=1e-6)


@pytest.mark.parametrize("count", [9, 64, 333])
def test_nodes_are_split_at_the_median_along_their_longest_side(count):
    rng = np.random.default_rng(count)
    centers = np.round(rng.normal(size=(count, 3)) * [1, 3, 2], 1)  # with ties
    order, levels = np.arange(count), 3
    split_at_medians(centers, levels, order, np.empty(count))
    assert sorted(order) == list(range(count))
    for level in range(levels):
        for k in range(1 << level):
            first, last = (n * count // (1 << level) for n in (k, k + 1))
            middle = (2 * k + 1) * count // (2 << level)
            part = centers[order[first:last]]
            along = part[:, np.argmax(np.ptp(part, axis=0))]
            assert along[: middle - first].max() <= along[middle - first :].min()


def test_cube_whose_faces_edges_and_corners_lie_on_grid_columns():
    winding = np.empty((7, 7, 7), dtype=np.int16)
    winding_numbers(CUBE * 4 + 1, CUBE_FACES, winding)
    assert set(np.unique(winding)) == {0, 1}
    assert (winding[2:5, 2:5, 2:5] == 1).all()
    assert winding.sum() == 4**3  # half-open: each border column belongs to exactly one side


def test_inverted_and_nested_surfaces():
    winding = np.empty((7, 7, 7), dtype=np.int16)
    winding_numbers(CUBE * 4 + 0.9, CUBE_FACES[:, ::-1].copy(), winding)
    assert winding[3, 3, 3] == -1
    both = np.vstack([CUBE * 4 + 0.9, CUBE * 2 + 1.8])
    winding_numbers(both, np.vstack([CUBE_FACES, CUBE_FACES + 8]), winding)
    assert winding[3, 3, 3] == 2
    assert winding[1, 1, 1] == 1


def test_surface_that_starts_below_the_grid():
    winding = np.empty((3, 3, 3), dtype=np.int16)
    winding_numbers(CUBE * 20 - 10, CUBE_FACES, winding)
    assert (winding == 1).all()
