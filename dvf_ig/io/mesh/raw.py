"""Intermediate form of the mesh formats: arrays, and the text that may hold the SPACE tag."""

from dataclasses import dataclass, field

import numpy as np

from dvf_ig.core import AnyArray, FloatArray, IntArray, read_only_arrays


class MeshFormatError(Exception):
    """Damaged or unsupported content; the message completes the sentence "<file>: …"."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RawMesh:
    """A mesh as stored in a file.

    Attributes:
        vertices: (v, 3), in the space that `note` states.
        triangles: (m, 3) vertex indices from 0.
        note: header or comment text, which may contain "SPACE=LPS" or "SPACE=RAS".
        cell_flags: named values per triangle (VTP only).
        left_out: content of the file that is not part of a surface, each with its count: "3 lines".
    """

    vertices: FloatArray
    triangles: IntArray
    note: str = ""
    cell_flags: dict[str, AnyArray] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()


def text_lines(text: str) -> list[str]:
    """Split lines at LF, CR LF or CR; other separators belong to names and comments."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def fan_triangles(polygons: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """Split polygons into triangle fans.

    Args:
        polygons: vertex indices, one polygon after the other.
        counts: number of vertices of each polygon.
    Returns:
        (m, 3) triangles and (m,) the polygon each comes from.
    Raises:
        MeshFormatError: a polygon of fewer than three vertices.
    """
    first, step, owner = _triangle_steps(counts, "polygon")
    columns = [polygons[first], polygons[first + step + 1], polygons[first + step + 2]]
    return np.stack(columns, axis=1).astype(np.int64), owner


def strip_triangles(strips: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """Split triangle strips, in which every second triangle is reversed; see `fan_triangles`."""
    first, step, owner = _triangle_steps(counts, "triangle strip")
    turned = step % 2
    columns = [strips[first + step], strips[first + step + 1 + turned], strips[first + step + 2 - turned]]
    return np.stack(columns, axis=1).astype(np.int64), owner


def _triangle_steps(counts: IntArray, what: str) -> tuple[IntArray, IntArray, IntArray]:
    """Return for each triangle the start of its cell, its number in the cell, and the cell."""
    short = np.flatnonzero(counts < 3)
    if len(short):
        raise MeshFormatError(
            f"{len(short)} of {len(counts)} {what}s have fewer than 3 corners, first number {short[0] + 1}; "
            "export the mesh again as triangles"
        )
    per = counts - 2
    owner = np.repeat(np.arange(len(counts)), per)
    step = np.arange(int(per.sum())) - np.repeat(np.cumsum(per) - per, per)
    return (np.cumsum(counts) - counts)[owner], step, owner


def whole_indices(values: AnyArray, vertices: int, what: str) -> IntArray:
    """Convert vertex indices to integers.

    Raises:
        MeshFormatError: an index is not a whole number, or not below `vertices`.
    """
    if np.issubdtype(values.dtype, np.integer):
        wrong = (values < 0) | (values >= vertices)
    else:
        wrong = ~((values >= 0) & (values < vertices) & (values == np.floor(values)))
    if wrong.any():
        raise MeshFormatError(
            f"a {what} refers to vertex {values[np.argmax(wrong)]:g}; needed a whole number from 0 to "
            f"{vertices - 1}: export the mesh again"
        )
    return values.astype(np.int64)


def left_after(data: bytes | memoryview, declared: str, record_bytes: int) -> tuple[str, ...]:
    """Describe the bytes after the last declared triangle, which cannot hold another one.

    Args:
        declared: the count that the header states, for the message.
        record_bytes: size of one triangle.
    Raises:
        MeshFormatError: enough bytes for a triangle that are not all zero.
    """
    count = len(data)
    if count >= record_bytes and bytes(data).strip(b"\0\r\n\t "):
        raise MeshFormatError(
            f"{count} bytes follow the {declared} of its header, enough for {count // record_bytes} more: "
            "export the whole surface as one mesh"
        )
    return (f"{count} bytes after the {declared}",) if count else ()
