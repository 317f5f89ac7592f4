"""Closed surfaces with a known distance."""

import numpy as np

from dvf_ig.core import CycleTiming, SurfaceSeries


def sphere(radius: float, subdivisions: int = 4, center=(0.0, 0.0, 0.0)):
    """Vertices on the sphere and triangles of a subdivided icosahedron, outward."""
    g = (1 + 5**0.5) / 2
    vertices: list[tuple[float, float, float]] = [
        (-1, g, 0),
        (1, g, 0),
        (-1, -g, 0),
        (1, -g, 0),
        (0, -1, g),
        (0, 1, g),
    ]
    vertices += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2)]
    faces += [(10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5)]
    faces += [(2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    points, triangles = np.array(vertices, dtype=float), np.array(faces)
    for _ in range(subdivisions):
        edges = np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = (index.reshape(3, -1) + len(points)).T
        points = np.vstack([points, points[unique].mean(axis=1)])
        a, b, c = triangles.T
        ab, bc, ca = middle.T
        triangles = np.vstack(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    return points + np.array(center), triangles


def beating_sphere_series() -> SurfaceSeries:
    """Radius 20, 17 and 18.5 mm at 0, 0.3 and 0.7 of the cycle."""
    vertices, triangles = sphere(1.0)
    timing = CycleTiming(np.array([0.0, 0.3, 0.7]), 0.85)
    stack = np.stack([radius * vertices for radius in (20.0, 17.0, 18.5)])
    return SurfaceSeries("EPICARDIAL", "mr", stack, triangles, timing, "ball")
