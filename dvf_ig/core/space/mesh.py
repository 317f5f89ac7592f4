"""Triangle surfaces, single and as a corresponding series over the cycle."""

from dataclasses import dataclass, field

import numpy as np

from dvf_ig.core.arrays import BoolArray, FloatArray, IntArray, frozen, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.timing.cycle import CycleTiming

from .frames import check_frame

LV_CAVITY = "LV_ENDOCARDIAL"
"""Name of the series whose volume gives end-diastole and end-systole."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangle surface in one frame; counter-clockwise seen from outside.

    Attributes:
        frame: frame name.
        vertices_mm: (v, 3).
        triangles: (m, 3) vertex indices.
    """

    frame: str
    vertices_mm: FloatArray
    triangles: IntArray

    def __post_init__(self) -> None:
        check_frame(self.frame)
        vertices = frozen_floats(self.vertices_mm, "mesh vertices", (None, 3))
        object.__setattr__(self, "vertices_mm", vertices)
        object.__setattr__(self, "triangles", _checked_triangles(self.triangles, len(vertices)))

    def volume_mm3(self) -> float:
        """Enclosed volume (positive for outward orientation); meaningful for a closed mesh only."""
        return enclosed_volume_mm3(self.vertices_mm, self.triangles)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSeries:
    """Surface that keeps its vertices over the cycle.

    Attributes:
        name: anatomical name, for example "EPICARDIAL".
        frame: frame name.
        vertices_mm: (n, v, 3), vertex i is the same material point in every phase.
        triangles: (m, 3).
        timing: phase times.
        patient_id: identifier of the patient.
        caps: (m,) True for triangles added to close the surface, not measured ones.
    """

    name: str
    frame: str
    vertices_mm: FloatArray
    triangles: IntArray
    timing: CycleTiming
    patient_id: str
    caps: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        check_frame(self.frame)
        vertices = frozen_floats(self.vertices_mm, f"surface {self.name}", (len(self.timing), None, 3))
        triangles = _checked_triangles(self.triangles, vertices.shape[1])
        caps = self.caps if len(self.caps) else np.zeros(len(triangles), dtype=np.bool_)
        object.__setattr__(self, "vertices_mm", vertices)
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "caps", frozen(caps, "cap flags", (len(triangles),), np.bool_))

    def phase(self, i: int) -> Mesh:
        return Mesh(self.frame, self.vertices_mm[i], self.triangles)

    def volumes_mm3(self) -> FloatArray:
        """Compute the (n,) enclosed volume per phase."""
        return np.array([enclosed_volume_mm3(v, self.triangles) for v in self.vertices_mm])


def enclosed_volume_mm3(vertices_mm: FloatArray, triangles: IntArray) -> float:
    """Compute the signed volume enclosed by triangles (divergence theorem about the centroid)."""
    a, b, c = (vertices_mm[triangles[:, k]] - vertices_mm.mean(axis=0) for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def _checked_triangles(triangles: IntArray, vertices: int) -> IntArray:
    out = frozen(triangles, "mesh triangles", (None, 3), np.int64)
    if len(out) == 0:
        raise InvalidInputError("a mesh has no triangles; needed at least one")
    if out.min() < 0 or out.max() >= vertices:
        raise InvalidInputError(
            f"a triangle refers to vertex {int(out.max())} (smallest {int(out.min())}), "
            f"but the mesh has {vertices} vertices"
        )
    return out
