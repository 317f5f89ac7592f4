"""Read and write Wavefront OBJ: vertices and faces; normals, texture, names and materials are ignored."""

from collections.abc import Iterator

import numpy as np

from dvf_ig.core.arrays import IntArray

from .raw import MeshFormatError, RawMesh, fan_triangles, text_lines

_HARMLESS = frozenset(
    {"vn", "vt", "vp", "g", "o", "s", "mg", "usemtl", "mtllib", "usemap", "maplib", "shadow_obj", "trace_obj"}
    | {"bevel", "c_interp", "d_interp", "lod"}
)
"""Keywords of lines that do not affect the surface."""
_WITHOUT_SURFACE = {"p": "points", "l": "lines"}


def decode_obj(data: bytes) -> RawMesh:
    """Decode an OBJ file; indices may be relative, faces may be polygons, a backslash continues a line."""
    vertices: list[list[str]] = []
    faces: list[list[str]] = []
    counts_at_face: list[int] = []
    notes: list[str] = []
    left_out = dict.fromkeys(_WITHOUT_SURFACE, 0)
    for line in _whole_lines(data.decode("utf-8-sig", "replace")):
        words = line.split("#", 1)[0].split()
        keyword = words[0] if words else ""
        if keyword == "v":
            vertices.append(_vertex(words[1:], len(vertices)))
        elif keyword == "f":
            corners = words[1:]
            faces.append([corner.split("/", 1)[0] for corner in corners] if "/" in line else corners)
            counts_at_face.append(len(vertices))
        elif keyword in _WITHOUT_SURFACE:
            left_out[keyword] += 1
        elif keyword and keyword not in _HARMLESS:
            raise MeshFormatError(
                f"{line.strip()[:40]!r}: '{keyword[:20]}' is unsupported and may hold a part of the surface; "
                "export the mesh as triangles (lines 'v' and 'f')"
            )
        if "#" in line:
            notes.append(line)
    if not vertices or not faces:
        raise MeshFormatError(
            f"{len(vertices)} vertices and {len(faces)} faces; needed an OBJ mesh with both"
        )
    counts = np.array([len(face) for face in faces])
    triangles, _ = fan_triangles(_corners(faces, np.repeat(counts_at_face, counts)), counts)
    named = tuple(f"{count} {_WITHOUT_SURFACE[key]}" for key, count in left_out.items() if count)
    return RawMesh(np.array(vertices, dtype=np.float64), triangles, "\n".join(notes), left_out=named)


def _whole_lines(text: str) -> Iterator[str]:
    """Yield lines; geometry continues after a backslash, names and comments do not."""
    begun = ""
    for part in text_lines(text):
        line = begun + part
        continued = line.endswith("\\") and "#" not in line and line.split()[0] not in _HARMLESS
        begun = line[:-1] + " " if continued else ""
        if not begun:
            yield line
    yield begun


def _vertex(numbers: list[str], before: int) -> list[str]:
    """Return x, y and z of a line `v x y z`, optionally followed by a weight of 1, a colour or both."""
    if len(numbers) not in (3, 4, 6, 7) or (len(numbers) in (4, 7) and float(numbers[3]) != 1.0):
        raise MeshFormatError(
            f"vertex {before + 1} is '{' '.join(numbers)[:60]}'; needed x y z, and no weight but 1: export "
            "the mesh again"
        )
    return numbers[:3]


def _corners(faces: list[list[str]], seen: IntArray) -> IntArray:
    """Convert vertex indices to start at 0; `seen` counts the vertices before each corner."""
    stated = np.array([int(corner) for face in faces for corner in face], dtype=np.int64)
    corners = np.where(stated < 0, stated + seen, stated - 1)
    if (corners < 0).any():
        raise MeshFormatError(
            f"a face refers to vertex {stated[np.argmin(corners)]}; needed 1 for the first, or a negative "
            "number that counts from the last vertex before the face: export the mesh again"
        )
    return corners


def encode_obj(mesh: RawMesh) -> bytes:
    """Encode OBJ text with the SPACE tag in a comment and every digit of the vertices."""
    lines = [f"# {mesh.note}"]
    lines += ["v {!r} {!r} {!r}".format(*row) for row in mesh.vertices.tolist()]
    lines += ["f {} {} {}".format(*row) for row in (mesh.triangles + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("utf-8")
