"""Convert the blood-filled chambers of a model to and from the arrays of its file."""

from collections.abc import Sequence

import numpy as np

from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.model import Chamber
from dvf_ig.core.space.mesh import Mesh


def chamber_arrays(chambers: Sequence[Chamber]) -> dict[str, AnyArray]:
    """Concatenate vertices (float32) and triangles (int32) of every chamber and phase, with counts.

    A phase with the same triangles as the previous one stores none: its count is 0.
    """
    vertices, triangles, vertex_counts, triangle_counts = [], [], [], []
    for chamber in chambers:
        before = None
        for mesh in chamber.surfaces:
            own = before is None or not np.array_equal(mesh.triangles, before)
            before = mesh.triangles
            vertices.append(mesh.vertices_mm)
            vertex_counts.append(len(mesh.vertices_mm))
            triangle_counts.append(len(mesh.triangles) if own else 0)
            if own:
                triangles.append(mesh.triangles)
    return {
        "chamber_vertices_mm": np.concatenate(vertices).astype(np.float32),
        "chamber_triangles": np.concatenate(triangles).astype(np.int32),
        "chamber_vertex_counts": np.array(vertex_counts, dtype=np.int64),
        "chamber_triangle_counts": np.array(triangle_counts, dtype=np.int64),
    }


def chambers_of_arrays(names: Sequence[str], frame: str, arrays: dict[str, AnyArray]) -> tuple[Chamber, ...]:
    """Rebuild the chambers of a file; empty for files of versions without chambers.

    Raises:
        KeyError: an array is missing.
    """
    if not names:
        return ()
    vertices = np.split(arrays["chamber_vertices_mm"], np.cumsum(arrays["chamber_vertex_counts"])[:-1])
    triangles = np.split(arrays["chamber_triangles"], np.cumsum(arrays["chamber_triangle_counts"])[:-1])
    meshes: list[Mesh] = []
    for own_vertices, own_triangles in zip(vertices, triangles, strict=True):
        shared = own_triangles if len(own_triangles) else meshes[-1].triangles
        meshes.append(Mesh(frame, own_vertices, shared))
    phases = len(meshes) // len(names)
    return tuple(Chamber(name, tuple(meshes[k * phases : (k + 1) * phases])) for k, name in enumerate(names))
