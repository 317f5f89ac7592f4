"""A sphere meets a plane in a circle."""

from collections.abc import Callable

import numpy as np

from dvf_ig.report.plane_overlay import plane_section


def test_a_sphere_is_cut_in_a_circle(sphere_of: Callable[..., tuple[np.ndarray, np.ndarray]]) -> None:
    vertices, triangles = sphere_of(10.0)
    segments = plane_section(vertices[triangles], 1, 6.001)
    assert np.allclose(segments[..., 1], 6.001)
    # facets lie inside the sphere by up to 10 mm · (1 − cos(half an edge's angle))
    assert np.allclose(np.linalg.norm(segments[..., [0, 2]], axis=-1), 8.0, atol=0.05)
    lengths = np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1)
    assert np.isclose(lengths.sum(), 2 * np.pi * 8.0, rtol=0.01)


def test_a_plane_beside_the_mesh_meets_nothing(
    sphere_of: Callable[..., tuple[np.ndarray, np.ndarray]],
) -> None:
    vertices, triangles = sphere_of(10.0)
    assert plane_section(vertices[triangles], 0, 11.0).shape == (0, 2, 3)
