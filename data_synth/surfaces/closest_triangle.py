"""Exact signed distance from points to a deforming triangle mesh (numba).

The nearest point of the nearest triangle decides the distance; its sign comes from the angle-weighted
pseudo-normal of the feature it lies on (face, edge or vertex), which is right for every closed mesh.
The mesh samples a smooth organ: facets turn by several degrees from one to the next where the organ does not.
The gradient is therefore the vertex pseudo-normals interpolated at the nearest point, not a facet's normal.
Triangles are grouped in small clusters; bounding spheres skip clusters, never a nearest triangle.

Sources: Ericson, Real-Time Collision Detection (2005), 5.1.5; Baerentzen and Aanaes, IEEE TVCG 11:243 (2005).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

VERTEX, EDGE, FACE = 0, 3, 6
"""Feature codes: vertex 0–2, edge 3–5 (edge k from corner k to corner k+1), face 6."""


def _closest_on_triangle(p: Any, a: Any, b: Any, c: Any, out: Any) -> int:
    """Nearest point of triangle abc to p, written to `out`; returns the feature code."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        out[:] = a
        return 0
    bp = p - b
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        out[:] = b
        return 1
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        out[:] = a + (d1 / (d1 - d3)) * ab
        return 3
    cp = p - c
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        out[:] = c
        return 2
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        out[:] = a + (d2 / (d2 - d6)) * ac
        return 5
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        out[:] = b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b)
        return 4
    scale = 1.0 / (va + vb + vc)
    out[:] = a + (vb * scale) * ab + (vc * scale) * ac
    return 6


def _plain_dot(u: Any, v: Any) -> float:
    return float(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


def _plain_vertex(low: Any, high: Any, weight: float, index: int, out: Any) -> None:
    for k in range(3):
        out[k] = (1.0 - weight) * low[index, k] + weight * high[index, k]


def _plain_normal(low: Any, high: Any, weight: float, triangle: Any, corners: Any, out: Any) -> None:
    """Unit normal of a triangle between two cached phases; fills `corners` (3, 3)."""
    for k in range(3):
        _vertex(low, high, weight, triangle[k], corners[k])
    u, v = corners[1] - corners[0], corners[2] - corners[0]
    out[0] = u[1] * v[2] - u[2] * v[1]
    out[1] = u[2] * v[0] - u[0] * v[2]
    out[2] = u[0] * v[1] - u[1] * v[0]
    length = np.sqrt(_dot(out, out))
    if length > 0.0:
        out /= length


def _plain_pseudo_normal(
    low: Any, high: Any, weight: float, triangles: Any, start: Any, around: Any, neighbour: Any,
    triangle: int, feature: int, out: Any,
) -> None:  # fmt: skip
    """Outward pseudo-normal (not of unit length) of a feature of `triangle`."""
    corners, normal = np.empty((3, 3)), np.empty(3)
    if feature >= 3:
        _normal(low, high, weight, triangles[triangle], corners, out)
        if feature < 6 and neighbour[triangle, feature - 3] >= 0:
            _normal(low, high, weight, triangles[neighbour[triangle, feature - 3]], corners, normal)
            out += normal
        return
    vertex = triangles[triangle, feature]
    out[:] = 0.0
    for slot in range(start[vertex], start[vertex + 1]):
        other = around[slot]
        _normal(low, high, weight, triangles[other], corners, normal)
        for k in range(3):
            if triangles[other, k] == vertex:
                u = corners[(k + 1) % 3] - corners[k]
                v = corners[(k + 2) % 3] - corners[k]
                cosine = _dot(u, v) / np.sqrt(_dot(u, u) * _dot(v, v) + 1e-300)
                out += np.arccos(min(1.0, max(-1.0, cosine))) * normal


def _plain_smooth_normal(
    low: Any, high: Any, weight: float, triangles: Any, start: Any, around: Any, neighbour: Any,
    triangle: int, point: Any, out: Any,
) -> None:  # fmt: skip
    """Outward unit normal at a point of `triangle`: its corners' unit pseudo-normals by area weights."""
    corners, face, spoke, vertex_normal = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    _normal(low, high, weight, triangles[triangle], corners, face)
    out[:] = 0.0
    for k in range(3):
        u, v = corners[(k + 1) % 3] - point, corners[(k + 2) % 3] - point
        spoke[0] = u[1] * v[2] - u[2] * v[1]
        spoke[1] = u[2] * v[0] - u[0] * v[2]
        spoke[2] = u[0] * v[1] - u[1] * v[0]
        share = max(_dot(spoke, face), 0.0)
        _pseudo_normal(low, high, weight, triangles, start, around, neighbour, triangle, k, vertex_normal)
        out += share / np.sqrt(_dot(vertex_normal, vertex_normal) + 1e-300) * vertex_normal
    out /= np.sqrt(_dot(out, out) + 1e-300)


def _plain_nearest(
    p: Any, low: Any, high: Any, weight: float, triangles: Any, clusters: Any,
    center_low: Any, center_high: Any, radius_low: Any, radius_high: Any, best_point: Any,
) -> tuple[float, int, int]:  # fmt: skip
    """Distance, triangle and feature of the mesh point nearest to p (written to `best_point`)."""
    count = len(clusters) - 1
    gap, first = np.empty(count), 0
    nearest = np.inf
    for c in range(count):
        square = 0.0
        for k in range(3):
            step = (1.0 - weight) * center_low[c, k] + weight * center_high[c, k] - p[k]
            square += step * step
        centre = np.sqrt(square)
        gap[c] = centre - max(radius_low[c], radius_high[c])
        if centre < nearest:
            nearest, first = centre, c
    corners, candidate = np.empty((3, 3)), np.empty(3)
    best, best_triangle, best_feature = np.inf, -1, 6
    for turn in range(count + 1):
        c = first if turn == 0 else turn - 1
        if (turn > 0 and c == first) or gap[c] > best:
            continue
        for t in range(clusters[c], clusters[c + 1]):
            for k in range(3):
                _vertex(low, high, weight, triangles[t, k], corners[k])
            feature = _closest(p, corners[0], corners[1], corners[2], candidate)
            step_x, step_y, step_z = candidate[0] - p[0], candidate[1] - p[1], candidate[2] - p[2]
            distance = np.sqrt(step_x * step_x + step_y * step_y + step_z * step_z)
            if distance < best:
                best, best_triangle, best_feature = distance, t, feature
                best_point[:] = candidate
    return best, best_triangle, best_feature


def _plain_signed_distances(
    points: Any, lower: Any, upper: Any, weights: Any, vertices: Any, triangles: Any, clusters: Any,
    centers: Any, radii: Any, start: Any, around: Any, neighbour: Any, distance: Any, gradient: Any,
) -> None:  # fmt: skip
    """Signed distance (positive inside) and its unit gradient for every point.

    Args:
        points: (n, 3) mm.
        lower, upper, weights: (n,) cached phases on both sides and the weight of the upper.
        vertices: (phases, v, 3); triangles (m, 3) sorted by cluster; clusters (c+1,) offsets.
        centers, radii: (phases, c, 3) and (phases, c) bounding spheres.
        start, around: triangles around each vertex (offsets, indices); neighbour (m, 3) across each edge.
        distance, gradient: (n,) and (n, 3), written.
    """
    nearest, normal = np.empty(3), np.empty(3)
    for i in range(len(points)):
        a, b, w = lower[i], upper[i], weights[i]
        low, high = vertices[a], vertices[b]
        length, triangle, feature = _nearest(
            points[i], low, high, w, triangles, clusters,
            centers[a], centers[b], radii[a], radii[b], nearest,
        )  # fmt: skip
        _pseudo_normal(low, high, w, triangles, start, around, neighbour, triangle, feature, normal)
        offset = points[i] - nearest
        outside = _dot(offset, normal) > 0.0
        distance[i] = -length if outside else length
        _smooth_normal(low, high, w, triangles, start, around, neighbour, triangle, nearest, normal)
        gradient[i] = -normal


_dot: Callable[..., float] = njit(cache=True)(_plain_dot)
_vertex: Callable[..., None] = njit(cache=True)(_plain_vertex)
_normal: Callable[..., None] = njit(cache=True)(_plain_normal)
_closest: Callable[..., int] = njit(cache=True)(_closest_on_triangle)
_pseudo_normal: Callable[..., None] = njit(cache=True)(_plain_pseudo_normal)
_smooth_normal: Callable[..., None] = njit(cache=True)(_plain_smooth_normal)
_nearest: Callable[..., tuple[float, int, int]] = njit(cache=True)(_plain_nearest)
signed_distances: Callable[..., None] = njit(cache=True, nogil=True)(_plain_signed_distances)
