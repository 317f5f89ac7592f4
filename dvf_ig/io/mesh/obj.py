"""Wavefront OBJ: vertices and faces; texture and normal indices are ignored."""

import numpy as np

from .raw import MeshFormatError, RawMesh, fan_triangles


def decode_obj(data: bytes) -> RawMesh:
    """Mesh of an OBJ file; indices may be relative, faces may be polygons."""
    vertices: list[list[str]] = []
    faces: list[list[str]] = []
    counts_at_face: list[int] = []
    notes: list[str] = []
    for line in data.decode("utf-8", "replace").splitlines():
        if line.startswith("v "):
            vertices.append(line.split()[1:4])
        elif line.startswith("f "):
            faces.append([corner.split("/", 1)[0] for corner in line.split()[1:]])
            counts_at_face.append(len(vertices))
        elif line.startswith("#"):
            notes.append(line)
    if not vertices or not faces:
        raise MeshFormatError(
            f"{len(vertices)} vertices and {len(faces)} faces; needed an OBJ mesh with both"
        )
    counts = np.array([len(face) for face in faces])
    corners = np.array([int(corner) for face in faces for corner in face], dtype=np.int64)
    corners = np.where(corners < 0, corners + np.repeat(counts_at_face, counts), corners - 1)
    triangles, _ = fan_triangles(corners, np.cumsum(counts) - counts, counts)
    return RawMesh(np.array(vertices, dtype=np.float64), triangles, "\n".join(notes))


def encode_obj(mesh: RawMesh) -> bytes:
    """OBJ text with the SPACE tag in a comment and every digit of the vertices."""
    lines = [f"# {mesh.note}"]
    lines += ["v {!r} {!r} {!r}".format(*row) for row in mesh.vertices.tolist()]
    lines += ["f {} {} {}".format(*row) for row in (mesh.triangles + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("utf-8")
