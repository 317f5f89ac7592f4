"""A mesh in which a triangle has no neighbour, as `scripts/fuzz --cli` gave one."""

import numpy as np

from dvf_ig.preop.surface.topology import consistently_oriented


def test_a_triangle_without_neighbours_stays_as_it_is() -> None:
    triangles = np.array([[0, 1, 2], [3, 4, 5], [4, 3, 6]])
    np.testing.assert_array_equal(consistently_oriented(triangles, "ball"), triangles)
