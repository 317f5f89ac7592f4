"""Write the files of 3D Slicer nodes: transforms to parent, points, volumes over an index.

Slicer's world is RAS. An ITK transform file holds, in LPS, the inverse of a node's *transform to parent*
(vtkMRMLTransformStorageNode). Points in tracker coordinates have no anatomical axes: they are written as RAS,
which Slicer does not change.
"""

import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dvf_ig.core import RAS_FROM_LPS, AnyArray, FloatArray, Grid, InvalidInputError, Landmarks, OutputError
from dvf_ig.io.json_file import write_json
from dvf_ig.io.landmarks import markup_document
from dvf_ig.io.transform import affine_text
from dvf_ig.io.writing.atomic import write_bytes, write_text

_NRRD_TYPES = {
    "int8": "int8",
    "uint8": "uint8",
    "int16": "int16",
    "uint16": "uint16",
    "int32": "int32",
    "uint32": "uint32",
    "float32": "float",
    "float64": "double",
}


def write_node_transform(to_parent: FloatArray, path: Path) -> None:
    """Write a (4, 4) *transform to parent*, scene coordinates (RAS), mm, as the ITK file of its node.

    Raises:
        InvalidInputError: it has no inverse.
        OutputError: not writable.
    """
    if abs(np.linalg.det(to_parent[:3, :3])) < 1e-12:
        raise InvalidInputError(f"the transform of {path.stem} has no inverse")
    from_parent = RAS_FROM_LPS @ np.linalg.inv(to_parent) @ RAS_FROM_LPS
    write_text(path, affine_text(from_parent))


def write_node_points(
    landmarks: Landmarks, path: Path, *, tracked: bool, descriptions: Sequence[str] = ()
) -> None:
    """Write points as Slicer markups, each with a description.

    Args:
        landmarks: in an LPS frame such as "mr", or with `tracked` in a device's own coordinates.
        descriptions: one per point, or none.
    Raises:
        OutputError: not writable.
    """
    write_json(path, markup_document(landmarks, "RAS" if tracked else "LPS", descriptions))


def write_volume_sequence(
    path: Path, values: AnyArray, index: Sequence[float], *, grid: Grid, name: str, unit: str
) -> None:
    """Write images over an index as Slicer's volume sequence (`.seq.nrrd`), compressed.

    Args:
        values: (n, nx, ny, nz) of a type that NRRD supports.
        index: (n,) strictly increasing values of the index.
        grid: in LPS (`pixel_grid` for images in pixels).
        name, unit: of the index, for example "time" and "s".
    Raises:
        InvalidInputError: another number of index values, or a pixel type that the format lacks.
        OutputError: another ending, or not writable.
    Source: vtkMRMLVolumeSequenceStorageNode: axis 0 is the list, "axis 0 index values" name its items.
    """
    if not path.name.endswith(".seq.nrrd"):
        raise OutputError(f"cannot write {path}: volume sequences are written as .seq.nrrd; change the name")
    kind = _NRRD_TYPES.get(values.dtype.name)
    if kind is None or len(index) != len(values):
        raise InvalidInputError(
            f"{len(values)} images of {values.dtype.name} for {len(index)} index values; needed equal "
            f"numbers and a type among {', '.join(_NRRD_TYPES)}"
        )
    axes = grid.axes_mm
    sizes = (len(values), *values.shape[1:])
    header = [
        "NRRD0005",
        f"type: {kind}",
        "dimension: 4",
        "space: left-posterior-superior",
        f"sizes: {' '.join(map(str, sizes))}",
        f"space directions: none {' '.join(_vector(axes[:, axis]) for axis in range(3))}",
        "kinds: list domain domain domain",
        f'labels: "{name}" "" "" ""',
        f'units: "{unit}" "" "" ""',
        "endian: little",
        "encoding: gzip",
        f"space origin: {_vector(grid.origin_mm)}",
        "DataNodeClassName:=vtkMRMLScalarVolumeNode",
        "axis 0 index type:=numeric",
        f"axis 0 index values:={' '.join(f'{value:.3f}' for value in index)}",
    ]
    stored = np.asarray(values, dtype=values.dtype.newbyteorder("<"))
    pixels = np.ascontiguousarray(stored.transpose(3, 2, 1, 0))  # NRRD: the first axis is the fastest
    packer = zlib.compressobj(1, wbits=31)
    packed = [packer.compress(pixels.data), packer.flush()]
    write_bytes(path, ["\n".join([*header, "\n"]).encode(), *packed])


def pixel_grid(columns: int, rows: int) -> Grid:
    """Build the grid of one image in pixels: (column, row) is at (column, row, 0) of its node."""
    return Grid("image", (columns, rows, 1), np.zeros(3), np.ones(3), RAS_FROM_LPS[:3, :3])


def _vector(xyz: FloatArray) -> str:
    return f"({','.join(map(repr, xyz.tolist()))})"
