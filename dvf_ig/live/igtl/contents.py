"""Contents of OpenIGTLink messages from and to bytes: images, poses, texts and states."""

import struct

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.space.rigid import is_rigid
from dvf_ig.io import limits

from .message import (
    ASCII,
    UTF8,
    Image,
    Status,
    Text,
    TrackedTool,
    TrackingData,
    Transform,
    WireError,
    WireProblem,
    decode_text,
    rigid_matrix,
)

_LAYOUT = struct.Struct(">HBBBB3H12f3H3H")
_TYPES = {2: "i1", 3: "u1", 4: "i2", 5: "u2", 6: "i4", 7: "u4", 10: "f4", 11: "f8"}
_LITTLE = 2
_RAS, _LPS = 1, 2
_VERSIONS = (1, 2)


def decode_image(content: memoryview) -> Image:
    """Decode a whole image.

    Raises:
        WireError: sizes that do not fit each other, an unknown type, a part of an image, or a matrix that is
            not finite.
    """
    if len(content) < _LAYOUT.size:
        raise WireError(WireProblem.SIZE)
    version, components, scalar, endian, axes, *rest = _LAYOUT.unpack_from(content)
    size, numbers, offset, part = rest[:3], rest[3:15], rest[15:18], rest[18:21]
    supported = scalar in _TYPES and endian in (1, _LITTLE) and axes in (_RAS, _LPS) and version in _VERSIONS
    if not supported or not 1 <= components <= 4:
        raise WireError(WireProblem.VALUE)
    if min(size) == 0 or offset != [0, 0, 0] or part != size:
        raise WireError(WireProblem.SIZE)
    kind = np.dtype(("<" if endian == _LITTLE else ">") + _TYPES[scalar])
    count = size[0] * size[1] * size[2] * components
    if count * kind.itemsize != len(content) - _LAYOUT.size or count > limits.WIRE_IMAGE_BYTES:
        raise WireError(WireProblem.SIZE)
    shape = (size[2], size[1], size[0], components) if components > 1 else (size[2], size[1], size[0])
    pixels = np.frombuffer(content, dtype=kind, offset=_LAYOUT.size).reshape(shape)
    native = np.array(pixels, dtype=kind.newbyteorder("="))
    return Image(native, _from_wire(numbers, size), lps=axes == _LPS)


def encode_image(image: Image) -> bytes:
    """Encode a whole image with little-endian pixels.

    Raises:
        WireError: pixels of a type or a size that the protocol does not support.
    """
    pixels = image.pixels
    scalar = next((code for code, name in _TYPES.items() if np.dtype(name) == pixels.dtype), None)
    if (
        scalar is None
        or pixels.ndim not in (3, 4)
        or not 0 < min(pixels.shape) <= max(pixels.shape) < 1 << 16
    ):
        raise WireError(WireProblem.VALUE, "IMAGE")
    components = pixels.shape[3] if pixels.ndim == 4 else 1
    size = pixels.shape[2::-1]
    axes = _LPS if image.lps else _RAS
    numbers = _to_wire(image.matrix, size)
    head = _LAYOUT.pack(1, components, scalar, _LITTLE, axes, *size, *numbers, 0, 0, 0, *size)
    return head + pixels.astype(pixels.dtype.newbyteorder("<"), copy=False).tobytes()


def _from_wire(numbers: list[float], size: list[int]) -> FloatArray:
    columns = np.array(numbers).reshape(4, 3).T
    if not np.isfinite(columns).all() or np.abs(columns).max() > limits.LENGTH_MM:
        raise WireError(WireProblem.NOT_FINITE)
    matrix = np.eye(4)
    matrix[:3] = columns
    matrix[:3, 3] -= matrix[:3, :3] @ (0.5 * (np.array(size) - 1))
    return matrix


def _to_wire(matrix: FloatArray, size: tuple[int, ...]) -> list[float]:
    columns = matrix[:3].copy()
    columns[:, 3] += columns[:, :3] @ (0.5 * (np.array(size) - 1))
    return [float(x) for x in columns.T.ravel()]


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


_STATUS = struct.Struct(">Hq20s")
_STRING = struct.Struct(">HH")


def decode_status(content: memoryview) -> Status:
    """Decode a STATUS, or raise WireError if it is too short or its texts are invalid."""
    if len(content) < _STATUS.size:
        raise WireError(WireProblem.SIZE)
    code, subcode, name = _STATUS.unpack_from(content)
    text = bytes(content[_STATUS.size :]).rstrip(b"\0")
    shown = name.partition(b"\0")[0]
    return Status(code, subcode, decode_text(memoryview(shown), UTF8), decode_text(memoryview(text), UTF8))


def encode_status(status: Status) -> bytes:
    """Encode a STATUS, or raise WireError if a text is too long."""
    name, text = status.name.encode(), status.text.encode()
    if len(name) > 20 or len(text) >= limits.WIRE_TEXT_BYTES:
        raise WireError(WireProblem.TOO_LARGE, "STATUS")
    return _STATUS.pack(status.code, status.subcode, name) + text + b"\0"


def decode_string(content: memoryview) -> Text:
    """Decode a STRING, or raise WireError if its length is wrong or its bytes are not text."""
    if len(content) < _STRING.size:
        raise WireError(WireProblem.SIZE)
    encoding, length = _STRING.unpack_from(content)
    if length != len(content) - _STRING.size:
        raise WireError(WireProblem.SIZE)
    return Text(decode_text(content[_STRING.size :], encoding))


def encode_string(text: Text) -> bytes:
    """Encode a STRING, or raise WireError if the text is too long."""
    raw = text.text.encode()
    if len(raw) > limits.WIRE_TEXT_BYTES:
        raise WireError(WireProblem.TOO_LARGE, "STRING")
    return _STRING.pack(ASCII if raw.isascii() else UTF8, len(raw)) + raw
