"""TRANSFORM, TDATA, POSITION, QTRANS and QTDATA: rigid motions as matrices or quaternions."""

import struct

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.space.rigid import is_rigid
from dvf_ig.io import limits

from .message import TrackedTool, TrackingData, Transform, rigid_matrix
from .problem import WireError, WireProblem

TRANSFORM_BYTES = 48
_TOOL, _QUATERNION_TOOL = 70, 50
_NAME_BYTES = 20
_OTHER_TOOL = 3
"""Type of a tool with 6 degrees of freedom."""
_POSITION_BYTES = {12: 0, 24: 3, 28: 4}
"""Numbers of a quaternion by size of the POSITION in bytes; the last of three follows from the norm."""
_UNIT = 1e-2
"""Largest deviation of a quaternion's norm from 1."""


def decode_transform(content: memoryview) -> Transform:
    """Decode one rigid matrix, or raise WireError."""
    if len(content) != TRANSFORM_BYTES:
        raise WireError(WireProblem.SIZE)
    return Transform(_matrix(content))


def encode_transform(transform: Transform) -> bytes:
    """Encode the matrix by columns, the translation last."""
    return np.asarray(transform.matrix[:3].T, dtype=">f4").tobytes()


def decode_tracking(content: memoryview) -> TrackingData:
    """Decode tools with names and rigid poses, or raise WireError."""
    if len(content) % _TOOL:
        raise WireError(WireProblem.SIZE)
    return TrackingData(
        tuple(
            TrackedTool(_name(content[at : at + _NAME_BYTES]), _matrix(content[at + 22 : at + _TOOL]))
            for at in range(0, len(content), _TOOL)
        )
    )


def encode_tracking(data: TrackingData) -> bytes:
    """Encode tools, or raise WireError if a name is too long or not ASCII."""
    out = []
    for tool in data.tools:
        if len(tool.name) > _NAME_BYTES or not tool.name.isascii():
            raise WireError(WireProblem.NAME, "TDATA", tool.name)
        out.append(struct.pack(">20sBB", tool.name.encode("ascii"), _OTHER_TOOL, 0))
        out.append(encode_transform(Transform(tool.matrix)))
    return b"".join(out)


def decode_position(content: memoryview) -> Transform:
    """Decode POSITION and QTRANS: a translation, and a quaternion that may lack its last number or all."""
    if len(content) not in _POSITION_BYTES:
        raise WireError(WireProblem.SIZE)
    return Transform(_posed(np.frombuffer(content, dtype=">f4").astype(np.float64)))


def decode_quaternion_tracking(content: memoryview) -> TrackingData:
    """QTDATA."""
    if len(content) % _QUATERNION_TOOL:
        raise WireError(WireProblem.SIZE)
    tools = []
    for at in range(0, len(content), _QUATERNION_TOOL):
        numbers = np.frombuffer(content[at + 22 : at + _QUATERNION_TOOL], dtype=">f4").astype(np.float64)
        tools.append(TrackedTool(_name(content[at : at + _NAME_BYTES]), _posed(numbers)))
    return TrackingData(tuple(tools))


def _matrix(raw: memoryview) -> FloatArray:
    return _checked(rigid_matrix(np.frombuffer(raw, dtype=">f4").reshape(4, 3).T))


def _posed(numbers: FloatArray) -> FloatArray:
    """Build a matrix from (3,), (6,) or (7,): translation and quaternion x y z w."""
    if not np.isfinite(numbers).all():
        raise WireError(WireProblem.NOT_FINITE)
    quaternion = np.array([0.0, 0.0, 0.0, 1.0])
    quaternion[: len(numbers) - 3] = numbers[3:]
    if len(numbers) == 6:
        quaternion[3] = np.sqrt(max(0.0, 1.0 - float(numbers[3:] @ numbers[3:])))
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > _UNIT:
        raise WireError(WireProblem.NOT_RIGID)
    return _checked(rigid_matrix(np.column_stack([_rotation(quaternion / norm), numbers[:3]])))


def _rotation(quaternion: FloatArray) -> FloatArray:
    """Convert a unit quaternion x y z w to (3, 3)."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _checked(matrix: FloatArray) -> FloatArray:
    if not np.isfinite(matrix).all():
        raise WireError(WireProblem.NOT_FINITE)
    if np.abs(matrix[:3]).max() > limits.LENGTH_MM or not is_rigid(matrix):
        raise WireError(WireProblem.NOT_RIGID)
    return matrix


def _name(raw: memoryview) -> str:
    text = bytes(raw).partition(b"\0")[0]
    if not text or not text.isascii() or not text.decode("ascii").isprintable():
        raise WireError(WireProblem.VALUE)
    return text.decode("ascii")
