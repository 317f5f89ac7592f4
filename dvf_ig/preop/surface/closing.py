"""Closing a surface: vertices welded along split seams, openings capped, orientation made outward."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError, SurfaceSeries, read_only_arrays
from dvf_ig.core.space.mesh import enclosed_volume_mm3

from .topology import boundary_loops, connected_components_of, consistently_oriented, count_edges

log = logging.getLogger(__name__)

WELD_MM = 1e-6
MAX_CAP_SHARE = 0.3
"""Largest accepted area of all caps of a shell over its measured area. Valves take 0.11 of a real heart's
epicardium and up to 0.25 of a ventricle; half of a ball has 0.5."""
MAX_BEYOND_MM = 12.0
"""Largest accepted depth missing beyond a cap (see `Cap`): 7 to 11 mm at valves, 32 mm if half of a heart is
missing."""
TINY_MM2 = 1e-12
FLAT = 1e-6
"""Volume over area^1.5 below which a surface encloses nothing; a ball has 0.09, a coin 0.03."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Cap:
    """Opening of a surface that was closed.

    Attributes:
        area_mm2: area of its triangles.
        share: area of all caps of the same shell, by its measured area.
        beyond_mm: depth that may be missing: with area C and measured area A, C/sqrt(pi (A - C)). It is
            exact for a ball of which a slice was cut off.
        middle_mm: (3,) mean of the middles of its triangles.
    """

    area_mm2: float
    share: float
    beyond_mm: float
    middle_mm: FloatArray


def close_surface(series: SurfaceSeries) -> SurfaceSeries:
    """Weld a surface, orient it, cap its openings and turn it outwards.

    Vertices that coincide within 1e-6 mm in every phase become one; each opening gets a fan of triangles to
    its centroid (one vertex more, flagged in `caps`); each connected component encloses a positive volume.

    Raises:
        InvalidInputError: a one-sided surface, non-manifold edges, openings that touch, a surface that is
            still not closed (the message counts the edges), one that encloses nothing, or caps of more than
            MAX_CAP_SHARE of the measured area or with more than MAX_BEYOND_MM of the organ beyond.
    """
    vertices, triangles, caps = _welded(series)
    if not len(triangles):
        raise InvalidInputError(f"surface {series.name} has no area: its vertices coincide; export it again")
    if not count_edges(triangles).non_manifold_edges:
        triangles = consistently_oriented(triangles, series.name)
        vertices, triangles, caps = _capped(vertices, triangles, caps, series.name)
    census = count_edges(triangles)
    if not census.closed:
        raise InvalidInputError(
            f"surface {series.name} is not closed after welding and capping: {census}; repair the mesh"
        )
    _refuse_wide_caps(vertices, triangles, caps, series.name)
    triangles = _outward(vertices, triangles)
    _refuse_flat(vertices, triangles, series.name)
    return SurfaceSeries(
        series.name, series.frame, vertices, triangles, series.timing, series.patient_id, caps
    )


def _welded(series: SurfaceSeries) -> tuple[FloatArray, IntArray, BoolArray]:
    """Merge coinciding vertices; drop unused vertices and collapsed triangles."""
    pairs = cKDTree(series.vertices_mm[0]).query_pairs(2 * WELD_MM, output_type="ndarray")
    apart = np.abs(series.vertices_mm[:, pairs[:, 0]] - series.vertices_mm[:, pairs[:, 1]]).max(axis=(0, 2))
    pairs = pairs[apart <= WELD_MM]
    count = series.vertices_mm.shape[1]
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, group = connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    triangles = first[group][series.triangles]
    sound = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    used, compact = np.unique(triangles[sound], return_inverse=True)
    if len(used) < count:
        log.info("surface %s: %d vertices welded or unused", series.name, count - len(used))
    return series.vertices_mm[:, used], compact.reshape(-1, 3).astype(np.int64), series.caps[sound]


def _capped(
    vertices: FloatArray, triangles: IntArray, caps: BoolArray, name: str
) -> tuple[FloatArray, IntArray, BoolArray]:
    """Close each opening by a fan of triangles to its centroid."""
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


def caps_of(vertices_mm: FloatArray, triangles: IntArray, caps: BoolArray) -> tuple[Cap, ...]:
    """List the caps of a closed surface, the largest first; triangles that share vertices are one cap."""
    if not caps.any():
        return ()
    area = triangle_areas_mm2(vertices_mm, triangles)
    shell = connected_components_of(triangles)
    measured = np.bincount(shell, np.where(caps, 0.0, area))
    share = np.bincount(shell, np.where(caps, area, 0.0)) / np.maximum(measured, TINY_MM2)
    number = connected_components_of(triangles[caps])
    _, first = np.unique(number, return_index=True)
    of_cap = shell[caps][first]
    cap_area = np.bincount(number, area[caps])
    beyond_mm = cap_area / np.sqrt(np.pi * np.maximum(measured[of_cap] - cap_area, TINY_MM2))
    corners = vertices_mm[triangles[caps]].mean(axis=1)
    sums = np.stack([np.bincount(number, corners[:, k]) for k in range(3)], axis=1)
    middle = sums / np.bincount(number)[:, None]
    return tuple(
        Cap(float(cap_area[i]), float(share[of_cap[i]]), float(beyond_mm[i]), middle[i])
        for i in np.argsort(-cap_area, kind="stable")
    )


def describe_caps(caps: Sequence[Cap]) -> str:
    """Describe number, size and position of caps in words."""
    x, y, z = caps[0].middle_mm
    return (
        f"{len(caps)} cap{'s' * (len(caps) > 1)}, not measured, of {max(cap.share for cap in caps):.0%} of "
        f"the measured area; the largest has {caps[0].area_mm2:.0f} mm2 and its middle at ({x:.0f}, {y:.0f}, "
        f"{z:.0f}) mm; up to {max(cap.beyond_mm for cap in caps):.0f} mm of the organ may lie beyond"
    )


def _refuse_wide_caps(vertices: FloatArray, triangles: IntArray, flags: BoolArray, name: str) -> None:
    """Raise InvalidInputError if caps are too large for the openings of vessels and valves."""
    for phase, of_phase in enumerate(vertices):
        caps = caps_of(of_phase, triangles, flags)
        if any(cap.share > MAX_CAP_SHARE or cap.beyond_mm > MAX_BEYOND_MM for cap in caps):
            raise InvalidInputError(
                f"surface {name} is an open sheet or a part of an organ, not a shell with the openings of "
                f"vessels and valves: closing it in phase {phase} takes {describe_caps(caps)}; needed at "
                f"most {MAX_CAP_SHARE:.0%} and {MAX_BEYOND_MM:.0f} mm. Give the whole surface in one mesh, "
                "or close it in the program that made it"
            )


def _outward(vertices: FloatArray, triangles: IntArray) -> IntArray:
    """Flip components as needed so that each encloses a positive volume, summed over the cycle."""
    component = connected_components_of(triangles)
    out = triangles.copy()
    for number in range(int(component.max()) + 1):
        inside = component == number
        if sum(enclosed_volume_mm3(v, triangles[inside]) for v in vertices) < 0.0:
            out[inside] = out[inside][:, ::-1]
    return out


def _refuse_flat(vertices: FloatArray, triangles: IntArray, name: str) -> None:
    """Raise InvalidInputError for a phase in which the surface encloses nothing."""
    for phase, of_phase in enumerate(vertices):
        area = float(triangle_areas_mm2(of_phase, triangles).sum())
        if enclosed_volume_mm3(of_phase, triangles) <= FLAT * area**1.5:
            raise InvalidInputError(
                f"surface {name} encloses no volume in phase {phase}: it is flat or folded; export it again"
            )


def triangle_areas_mm2(vertices_mm: FloatArray, triangles: IntArray) -> FloatArray:
    """(t,) areas."""
    a, b, c = (vertices_mm[triangles[:, k]] for k in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
