"""Header of a model file: every field with its type and valid range; its chambers of blood."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from dvf_ig.core import AnyArray, Chamber, Grid, InvalidInputError, Mesh, Tissue, Volume, Warp
from dvf_ig.io import limits


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


def tissue_parts(tissue: Tissue) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    """Return the header and the arrays of a model's tissue."""
    grid, first = tissue.labels.grid, tissue.motion[0]
    header = {
        "label_mm": float(grid.spacing_mm[0]),
        "knot_mm": float(first.knot_mm),
        "names": [list(one) for one in tissue.names],
    }
    motion = np.stack([warp.coefficients for warp in tissue.motion])
    values = (tissue.labels.values, grid.origin_mm, motion, first.origin_mm)
    return header, dict(zip(TISSUE_ARRAYS, values, strict=True))


def tissue_of_arrays(header: "ModelHeader", arrays: dict[str, AnyArray]) -> Tissue | None:
    """Rebuild the tissue of a file; None for files without.

    Raises:
        KeyError: an array is missing.
        InvalidInputError: arrays of other shapes or types.
    """
    of = header.tissue
    if of is None:
        return None
    values, origin_mm, motion, knots_mm = (arrays[name] for name in TISSUE_ARRAYS)
    if values.ndim != 3 or motion.ndim != 5 or len(motion) != header.phases:
        raise InvalidInputError(
            f"its tissue has labels of shape {values.shape} and a motion of shape {motion.shape} for "
            f"{header.phases} phases; build it again"
        )
    nx, ny, nz = values.shape
    labels = Volume(Grid.axis_aligned(header.frame, (nx, ny, nz), origin_mm, of.label_mm), values)
    warps = tuple(Warp(header.frame, knots_mm, of.knot_mm, one) for one in motion)
    return Tissue(labels, of.names, warps)


SCHEMA_OF_PART = "dvf_ig.model/2"
"""Schema of a model of whose surface slices show a part (`SeenPart`)."""
SEEN_ARRAYS = ("seen_normal", "seen_bounds_mm", "seen_ends_mm", "seen_sigma_mm")

TISSUE_ARRAYS = ("tissue_labels", "tissue_origin_mm", "tissue_motion_mm", "tissue_motion_origin_mm")

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Text = Annotated[str, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]


class _Units(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    length: Literal["mm"]
    time: Literal["s"]
    coefficients: Literal["mm"]


class TissueHeader(BaseModel):
    """Pitch of the labels and of the motion's knots, names of label values."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    label_mm: Annotated[float, Field(strict=True, ge=0.1, le=20.0)]
    knot_mm: Annotated[float, Field(strict=True, ge=0.1, le=100.0)]
    names: tuple[tuple[Annotated[int, Field(strict=True, ge=0, le=255)], Text], ...] = ()


class ModelHeader(BaseModel):
    """Fields that `write_model` writes."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Text = Field(alias="schema")
    units: _Units
    distance_sign: Literal["positive inside the protected organ"]
    axes: Literal["LPS"]
    frame: Text
    patient_id: Text
    surface_name: Text
    phases: Annotated[int, Field(strict=True, ge=2)]
    rr_s: Number
    rr_assumed: Flag
    timing_assumed: Flag
    es_fraction: Annotated[float, Field(strict=True, ge=0.0, lt=1.0)]
    ed_phase: Annotated[int, Field(strict=True, ge=0)]
    knot_spacing_mm: Annotated[float, Field(strict=True, ge=0.05, le=100.0)]
    sources: tuple[Text, ...] = ()
    chambers: tuple[Text, ...] = ()
    cine_fingerprint: Text | None = None
    tissue: TissueHeader | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "ModelHeader":
        if self.ed_phase >= self.phases:
            raise ValueError(f"ed_phase is {self.ed_phase}, the model has {self.phases} phases")
        return self


def require_consistent(header: ModelHeader, arrays: dict[str, AnyArray]) -> None:
    """Refuse arrays that do not fit the header or each other, or lie outside any heart.

    Raises:
        InvalidInputError: names the array.
        KeyError: an array is missing.
    """
    phases, chambers = header.phases, len(header.chambers)
    if len(arrays["fractions"]) != phases or len(arrays["coefficients"]) != phases:
        raise InvalidInputError(
            f"its header states {phases} phases, its arrays have {len(arrays['fractions'])} and "
            f"{len(arrays['coefficients'])}; build it again"
        )
    _require_parts(arrays, "vertex_counts", "reference_vertices_mm", phases)
    for of_triangles in ("reference_triangles", "reference_caps"):
        _require_parts(arrays, "triangle_counts", of_triangles, phases)
    if chambers:
        _require_parts(arrays, "chamber_vertex_counts", "chamber_vertices_mm", phases * chambers)
        _require_parts(arrays, "chamber_triangle_counts", "chamber_triangles", phases * chambers)
    if (header.schema_ == SCHEMA_OF_PART) != all(name in arrays for name in SEEN_ARRAYS):
        raise InvalidInputError(
            f"its schema {header.schema_} does not fit its arrays of what slices show; build it again"
        )
    of_lengths = ("coefficients", "origin_mm", "reference_vertices_mm", "chamber_vertices_mm")
    for name in (*of_lengths, *SEEN_ARRAYS[1:], *TISSUE_ARRAYS[1:]):
        if name in arrays:
            _require_lengths(arrays[name], name)


def _require_parts(arrays: dict[str, AnyArray], counts: str, parts: str, number: int) -> None:
    """Refuse counts that do not add up to the parts."""
    stated: Any = arrays[counts]
    fits = stated.dtype.kind in "iu" and stated.shape == (number,) and (stated >= 0).all()
    if not fits or int(stated.sum()) != len(arrays[parts]):
        raise InvalidInputError(f"its {counts} do not match its {parts}; build it again")


def _require_lengths(array: AnyArray, name: str) -> None:
    """Check like `limits.require_lengths`, without a copy of large arrays."""
    if array.dtype.kind != "f":
        raise InvalidInputError(f"its {name} are not real numbers; build it again")
    if array.size and not (np.isfinite(array.min()) and np.isfinite(array.max())):
        raise InvalidInputError(f"its {name} are not all finite; build it again")
    if array.size:
        limits.require_lengths([array.min(), array.max()], f"its {name}")
