"""Closing a surface: vertices welded along split seams, openings capped, orientation made outward."""

import logging

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError, SurfaceSeries
from dvf_ig.core.space.mesh import enclosed_volume_mm3

from .topology import boundary_loops, connected_components_of, consistently_oriented, count_edges

log = logging.getLogger(__name__)

WELD_MM = 1e-6
MAX_CAP_SHARE = 0.5
"""Caps beyond this share of the measured area mean an open sheet, not a shell with holes."""


def close_surface(series: SurfaceSeries) -> SurfaceSeries:
    """Weld, orient, cap and turn outwards.

    Vertices that coincide within 1e-6 mm in every phase become one; each opening gets a fan of triangles to
    its centroid (one vertex more, flagged in `caps`); each connected component encloses a positive volume.

    Raises:
        InvalidInputError: a one-sided surface, non-manifold edges, openings that touch, caps larger than half
            of the measured area, or a surface that is still not closed; the message counts the edges.
    """
    vertices, triangles, caps = _welded(series)
    if not count_edges(triangles).non_manifold_edges:
        triangles = consistently_oriented(triangles, series.name)
        vertices, triangles, caps = _capped(vertices, triangles, caps, series.name)
    census = count_edges(triangles)
    if not census.closed:
        raise InvalidInputError(
            f"surface {series.name} is not closed after welding and capping: {census}; repair the mesh"
        )
    _refuse_sheet(vertices, triangles, caps, series.name)
    triangles = _outward(vertices, triangles)
    return SurfaceSeries(
        series.name, series.frame, vertices, triangles, series.timing, series.patient_id, caps
    )


def _welded(series: SurfaceSeries) -> tuple[FloatArray, IntArray, BoolArray]:
    """Coinciding vertices merged, unused vertices and collapsed triangles dropped."""
    pairs = cKDTree(series.vertices_mm[0]).query_pairs(2 * WELD_MM, output_type="ndarray")
    apart = np.abs(series.vertices_mm[:, pairs[:, 0]] - series.vertices_mm[:, pairs[:, 1]]).max(axis=(0, 2))
    pairs = pairs[apart <= WELD_MM]
    count = series.vertices_mm.shape[1]
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, group = connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    triangles = first[group][series.triangles]
    kept = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    used, compact = np.unique(triangles[kept], return_inverse=True)
    if len(used) < count:
        log.info("surface %s: %d vertices welded or unused", series.name, count - len(used))
    return series.vertices_mm[:, used], compact.reshape(-1, 3).astype(np.int64), series.caps[kept]


def _capped(
    vertices: FloatArray, triangles: IntArray, caps: BoolArray, name: str
) -> tuple[FloatArray, IntArray, BoolArray]:
    """A fan of triangles from each opening to its centroid."""
    fans: list[IntArray] = []
    centroids: list[FloatArray] = []
    count = vertices.shape[1]
    for loop in boundary_loops(triangles, name):
        apex = np.full(len(loop), count + len(centroids), dtype=np.int64)
        fans.append(np.column_stack([np.roll(loop, -1), loop, apex]))
        centroids.append(vertices[:, loop].mean(axis=1))
    if not fans:
        return vertices, triangles, caps
    added = np.vstack(fans)
    log.info("surface %s: %d openings capped with %d triangles", name, len(fans), len(added))
    return (
        np.concatenate([vertices, np.stack(centroids, axis=1)], axis=1),
        np.vstack([triangles, added]),
        np.concatenate([caps, np.ones(len(added), dtype=np.bool_)]),
    )


def _refuse_sheet(vertices: FloatArray, triangles: IntArray, caps: BoolArray, name: str) -> None:
    """Raise InvalidInputError where the caps are too large for a shell with holes."""
    if not caps.any():
        return
    area = triangle_areas_mm2(vertices[0], triangles)
    share = float(area[caps].sum() / max(area[~caps].sum(), 1e-12))
    if share > MAX_CAP_SHARE:
        raise InvalidInputError(
            f"surface {name} is an open sheet, not a shell with holes: caps would have {share:.0%} of its "
            f"measured area, needed at most {MAX_CAP_SHARE:.0%}; give the whole surface in one mesh"
        )


def _outward(vertices: FloatArray, triangles: IntArray) -> IntArray:
    """Each component flipped where needed so that its enclosed volume, summed over the cycle, is positive."""
    component = connected_components_of(triangles)
    out = triangles.copy()
    for number in range(int(component.max()) + 1):
        inside = component == number
        if sum(enclosed_volume_mm3(v, triangles[inside]) for v in vertices) < 0.0:
            out[inside] = out[inside][:, ::-1]
    return out


def triangle_areas_mm2(vertices_mm: FloatArray, triangles: IntArray) -> FloatArray:
    """(t,) areas."""
    a, b, c = (vertices_mm[triangles[:, k]] for k in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
