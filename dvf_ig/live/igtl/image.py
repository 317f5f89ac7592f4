"""IMAGE messages: pixels with their pose.

The wire gives the position of the image's centre; here the matrix takes indices (column, row, slice) to mm.
"""

import struct

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.io import limits

from .message import Image
from .problem import WireError, WireProblem

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
