"""What the mesh formats exchange with `mesh`: arrays, and the text that may hold the SPACE tag."""

from dataclasses import dataclass, field

import numpy as np

from dvf_ig.core import read_only_arrays
from dvf_ig.core.arrays import AnyArray, FloatArray, IntArray


class MeshFormatError(Exception):
    """Damaged or unsupported content; the message completes the sentence "<file>: …"."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RawMesh:
    """A mesh as a file holds it.

    Attributes:
        vertices: (v, 3), in the space that `note` names.
        triangles: (m, 3) vertex indices from 0.
        note: header or comment text, where "SPACE=LPS" or "SPACE=RAS" may stand.
        cell_flags: named values per triangle (VTP only).
    """

    vertices: FloatArray
    triangles: IntArray
    note: str = ""
    cell_flags: dict[str, AnyArray] = field(default_factory=dict)


def fan_triangles(polygons: IntArray, starts: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """Split polygons into triangle fans.

    Args:
        polygons: vertex indices, one polygon after the other.
        starts, counts: where each polygon starts and how many vertices it has; fewer than 3 are dropped.
    Returns:
        (m, 3) triangles and (m,) the polygon each comes from.
    """
    per = np.maximum(counts - 2, 0)
    owner = np.repeat(np.arange(len(counts)), per)
    step = np.arange(int(per.sum())) - np.repeat(np.cumsum(per) - per, per)
    first = starts[owner]
    columns = [polygons[first], polygons[first + step + 1], polygons[first + step + 2]]
    return np.stack(columns, axis=1).astype(np.int64), owner
