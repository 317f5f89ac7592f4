"""Topology of a triangle surface: closed or open edges, boundary loops, consistent orientation."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from dvf_ig.core import BoolArray, IntArray, InvalidInputError


@dataclass(frozen=True, slots=True)
class EdgeCensus:
    """Numbers of edges that a closed surface must not have.

    Attributes:
        open_edges: edges of only one triangle.
        non_manifold_edges: edges of more than two triangles.
        inconsistent_edges: edges that run the same way in both of their triangles.
    """

    open_edges: int
    non_manifold_edges: int
    inconsistent_edges: int

    def __str__(self) -> str:
        return (
            f"{self.open_edges} open edges, {self.non_manifold_edges} edges with more than two triangles, "
            f"{self.inconsistent_edges} edges with inconsistent orientation"
        )

    @property
    def closed(self) -> bool:
        return self.open_edges == self.non_manifold_edges == self.inconsistent_edges == 0


def directed_edges(triangles: IntArray) -> IntArray:
    """List (3t, 2) edges in triangle order: all first edges, then all second, then all third."""
    return np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def count_edges(triangles: IntArray) -> EdgeCensus:
    """Count wrong edges by one sort of numbers that hold smaller vertex, larger vertex and direction."""
    edges = directed_edges(triangles)
    forward = edges[:, 0] < edges[:, 1]
    vertices = int(triangles.max()) + 1
    code = np.sort(2 * (edges.min(axis=1) * vertices + edges.max(axis=1)) + forward)
    start = np.flatnonzero(np.append(True, code[1:] >> 1 != code[:-1] >> 1))
    uses = np.diff(np.append(start, len(code)))
    same_way = np.add.reduceat(code & 1, start) != 1
    return EdgeCensus(
        int(np.count_nonzero(uses == 1)),
        int(np.count_nonzero(uses > 2)),
        int(np.count_nonzero((uses == 2) & same_way)),
    )


def connected_components_of(triangles: IntArray) -> IntArray:
    """Find the (t,) connected component (sharing vertices) of each triangle."""
    vertices = int(triangles.max()) + 1
    edges = directed_edges(triangles)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(vertices, vertices))
    return np.unique(connected_components(graph, directed=False)[1][triangles[:, 0]], return_inverse=True)[1]


def consistently_oriented(triangles: IntArray, name: str) -> IntArray:
    """Flip triangles as needed so that shared edges run in opposite directions.

    Raises:
        InvalidInputError: the surface is one-sided, or an edge has more than two triangles.
    """
    count = len(triangles)
    edges = directed_edges(triangles)
    owner = np.tile(np.arange(count), 3)
    order = np.lexsort((edges.max(axis=1), edges.min(axis=1)))
    sorted_edges = np.sort(edges[order], axis=1)
    pair = np.flatnonzero((sorted_edges[1:] == sorted_edges[:-1]).all(axis=1))
    first, second = order[pair], order[pair + 1]
    same_way = edges[first, 0] == edges[second, 0]
    weight = np.where(same_way, 2, 1)
    one_way = csr_array((weight, (owner[first], owner[second])), shape=(count, count))
    graph = csr_array(one_way + one_way.T)
    flipped = _propagated_flips(graph, count)
    if (same_way == (flipped[owner[first]] == flipped[owner[second]])).any():
        raise InvalidInputError(
            f"surface {name} cannot be oriented: it is one-sided, or more than two triangles share an edge; "
            "repair the mesh"
        )
    out = triangles.copy()
    out[flipped] = out[flipped][:, ::-1]
    return out


def _propagated_flips(graph: csr_array, count: int) -> BoolArray:
    """Find (t,) triangles to flip, breadth first from each component's first triangle; weight 2 is a flip."""
    flipped = np.zeros(count, dtype=np.bool_)
    _, label = connected_components(graph, directed=False)
    _, roots = np.unique(label, return_index=True)
    for root in roots:
        order, parent = breadth_first_order(graph, root, directed=False)
        if len(order) < 2:  # a triangle without neighbours
            continue
        different = np.asarray(graph[parent[order[1:]], order[1:]]).ravel() == 2
        for triangle, flip in zip(order[1:], different, strict=True):
            flipped[triangle] = flipped[parent[triangle]] ^ flip
    return flipped


def boundary_loops(triangles: IntArray, name: str) -> list[IntArray]:
    """List openings as vertex cycles, each in the direction of the adjacent triangles.

    Raises:
        InvalidInputError: two openings touch in a vertex.
    """
    edges = directed_edges(triangles)
    _, index, uses = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    rim = edges[uses[index.ravel()] == 1]
    following = dict(zip(rim[:, 0].tolist(), rim[:, 1].tolist(), strict=True))
    if len(following) != len(rim):
        raise InvalidInputError(
            f"surface {name} has openings that touch: {len(rim)} boundary edges leave only {len(following)} "
            "vertices; repair the mesh"
        )
    loops = []
    while following:
        start = next(iter(following))
        loop = [start]
        vertex = following.pop(start)
        while vertex != start:
            loop.append(vertex)
            if vertex not in following:
                raise InvalidInputError(
                    f"surface {name} has a boundary that does not return to its start at vertex {vertex}; "
                    "repair the mesh"
                )
            vertex = following.pop(vertex)
        loops.append(np.array(loop, dtype=np.int64))
    return loops
