"""Closing a real, open surface series (weld, orient, cap, refine) without losing vertex correspondence."""

from collections import defaultdict, deque
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, InvalidInputError, SurfaceSeries, read_only_arrays
from dvf_ig.core.space.mesh import enclosed_volume_mm3

WELD_MM = 1e-6


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ClosedSeries:
    """Watertight surface over the cycle.

    Attributes:
        vertices_mm: (n, v, 3).
        triangles: (m, 3), outward.
        openings: vertex index of each cap's centre, largest opening first.
    """

    vertices_mm: FloatArray
    triangles: IntArray
    openings: IntArray


def closed_series(series: SurfaceSeries) -> ClosedSeries:
    """Weld vertices that coincide in every phase, orient outward, cap each boundary loop at its centroid.

    Raises:
        InvalidInputError: an edge with more than two triangles, a boundary that is not a loop, or a surface
            that cannot be oriented.
    """
    vertices, triangles = _welded(series.vertices_mm, np.array(series.triangles))
    triangles = _oriented(triangles, series.name)
    loops = sorted(_boundary_loops(triangles, series.name), key=len, reverse=True)
    centers = len(vertices[0]) + np.arange(len(loops))
    for center, loop in zip(centers, loops, strict=True):
        vertices = np.concatenate([vertices, vertices[:, loop].mean(axis=1, keepdims=True)], axis=1)
        # a boundary edge a→b of the surface is b→a of the cap
        fan = np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), center)])
        triangles = np.concatenate([triangles, fan])
    if enclosed_volume_mm3(vertices[0], triangles) < 0:
        triangles = triangles[:, ::-1].copy()
    return ClosedSeries(vertices, triangles, centers.astype(np.int64))


def refined(closed: ClosedSeries) -> ClosedSeries:
    """Split each triangle into four at its mid-edges."""
    t = closed.triangles
    edges = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middle = 0.5 * (closed.vertices_mm[:, unique[:, 0]] + closed.vertices_mm[:, unique[:, 1]])
    ab, bc, ca = (closed.vertices_mm.shape[1] + index.reshape(3, -1)).astype(np.int64)
    a, b, c = t.T
    split = [np.column_stack(corners) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return ClosedSeries(
        np.concatenate([closed.vertices_mm, middle], axis=1), np.concatenate(split), closed.openings
    )


def _welded(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    """Merge vertices whose whole trajectories agree to WELD_MM; drop triangles that collapse."""
    trajectory = np.round(vertices.transpose(1, 0, 2).reshape(vertices.shape[1], -1) / WELD_MM)
    _, first, inverse = np.unique(trajectory, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[triangles]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[:, first], faces[whole].astype(np.int64)


def _oriented(triangles: IntArray, name: str) -> IntArray:
    """Turn triangles so that neighbours agree, piece by piece."""
    by_edge: dict[tuple[int, int], list[int]] = defaultdict(list)
    for f, (a, b, c) in enumerate(triangles.tolist()):
        for u, v in ((a, b), (b, c), (c, a)):
            by_edge[(min(u, v), max(u, v))].append(f)
    crowded = sum(len(faces) > 2 for faces in by_edge.values())
    if crowded:
        raise InvalidInputError(
            f"surface {name} has {crowded} edges with more than two triangles; needed at most two; "
            "repair the mesh"
        )
    out = triangles.copy()
    seen = np.zeros(len(out), dtype=np.bool_)
    for start in range(len(out)):
        if seen[start]:
            continue
        seen[start] = True
        queue = deque([start])
        while queue:
            f = queue.popleft()
            a, b, c = out[f].tolist()
            for u, v in ((a, b), (b, c), (c, a)):
                for other in by_edge[(min(u, v), max(u, v))]:
                    if other == f:
                        continue
                    same_way = _has_edge(out[other].tolist(), u, v)
                    if seen[other] and same_way:
                        raise InvalidInputError(f"surface {name} cannot be oriented; repair the mesh")
                    if not seen[other]:
                        seen[other] = True
                        if same_way:
                            out[other] = out[other][::-1]
                        queue.append(other)
    return out


def _has_edge(corners: list[int], u: int, v: int) -> bool:
    a, b, c = corners
    return (u, v) in ((a, b), (b, c), (c, a))


def _boundary_loops(triangles: IntArray, name: str) -> list[IntArray]:
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges = {(int(a), int(b)) for a, b in directed}
    following = {a: b for a, b in edges if (b, a) not in edges}
    if len(following) != sum((b, a) not in edges for a, b in edges):
        raise InvalidInputError(f"surface {name} has boundaries that touch in one vertex; repair the mesh")
    loops = []
    while following:
        start = min(following)
        loop = [start]
        while (after := following.pop(loop[-1])) != start:
            loop.append(after)
            if after not in following:
                raise InvalidInputError(f"surface {name} has a boundary that is not a loop; repair the mesh")
        loops.append(np.array(loop, dtype=np.int64))
    return loops
