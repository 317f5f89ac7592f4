"""Read NIfTI: a header whose statements agree, and its voxels; damaged or sheared images are refused."""

import gzip
import logging
import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import AnyArray, FloatArray, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.inflate import inflated, require_size
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import read_bytes, refuse_lfs_pointer

from .header import ImageHeader, Storage
from .phase_times import uniform_times

log = logging.getLogger(__name__)

TOLERANCE = 1e-3
_FIELDS = {
    348: {
        "dim": ("8h", 40),
        "datatype": ("h", 70),
        "bitpix": ("h", 72),
        "pixdim": ("8f", 76),
        "vox_offset": ("f", 108),
        "toffset": ("f", 136),
        "scaling": ("2f", 112),
        "units": ("b", 123),
        "codes": ("2h", 252),
        "qform": ("6f", 256),
        "sform": ("12f", 280),
        "magic": ("4s", 344),
    },
    540: {
        "magic": ("4s", 4),
        "datatype": ("h", 12),
        "bitpix": ("h", 14),
        "dim": ("8q", 16),
        "pixdim": ("8d", 104),
        "vox_offset": ("q", 168),
        "toffset": ("d", 216),
        "scaling": ("2d", 176),
        "codes": ("2i", 344),
        "qform": ("6d", 352),
        "sform": ("12d", 400),
        "units": ("i", 500),
    },
}
"""Format and position of each field by header size (NIfTI-1, -2)."""
_TYPES = {
    2: "u1",
    4: "i2",
    8: "i4",
    16: "f4",
    64: "f8",
    256: "i1",
    512: "u2",
    768: "u4",
    1024: "i8",
    1280: "u8",
}
"""Supported data types: integers of 8 to 64 bit, float32, float64."""
_LPS = np.array([-1.0, -1.0, 1.0])
"""Signs that convert NIfTI's RAS to LPS."""
_GZIP = b"\x1f\x8b"
_MM = 2
_UNITS = {1: "m", 3: "micrometres"}
_TIME_UNITS = {0: "", 8: "s", 16: "ms", 24: "us"}
_SAME_SIDE = 0.01
"""Largest relative difference of two statements of a voxel's side."""
_SAME_MM, _SAME_SHARE = 0.1, 0.1
"""Largest distance of one voxel in two geometries: mm, and as a share of its smallest side."""


def nifti_files(path: Path) -> tuple[Path, ...]:
    """Return the other file of a pair (`.hdr`, `.img`)."""
    other = {".hdr": ".img", ".img": ".hdr"}.get(path.suffix.lower())
    if other is None:
        return ()
    return (path.with_suffix(other.upper() if path.suffix.isupper() else other),)


def read_nifti_header(path: Path) -> ImageHeader:
    """Check the header of a NIfTI file without reading voxels.

    Raises:
        UnreadableFileError: not NIfTI, truncated, implausible sizes, types, units or geometry, no
            orientation, two that differ, or axes that are not orthogonal; then with a repair command.
    """
    pair = nifti_files(path)
    header_file = path if path.suffix.lower() != ".img" else pair[0]
    for file in pair:
        refuse_lfs_pointer(file)
        if not file.is_file():
            raise UnreadableFileError(f"{file} does not exist; a NIfTI pair needs .hdr and .img together")
    return _parse(path, _begin(header_file, 540), single=not pair)


def read_nifti_voxels(path: Path, header: ImageHeader) -> AnyArray:
    """Read values indexed [x, y, z] or [phase, x, y, z]; values that the header scales become floats.

    Raises:
        UnreadableFileError: truncated, longer than its header says, or its compressed data are damaged.
    """
    voxels = path if path.suffix.lower() != ".hdr" else nifti_files(path)[0]
    offset = header.storage.offset
    needed = offset + header.bytes
    content: Any = read_bytes(voxels, "an image (NIfTI)")
    if content.startswith(_GZIP):
        content = inflated(path, content, needed)
    require_size(path, len(content), needed)
    for file in nifti_files(path):
        record_file(file)
    values = np.frombuffer(content, header.dtype, offset=offset).reshape(header.sizes[::-1]).T
    scaled = _scaled(values, *header.scaling)
    return scaled if header.phase_axis is None else np.moveaxis(scaled, header.phase_axis, 0)


def _scaled(values: AnyArray, slope: float, intercept: float) -> AnyArray:
    """Scale values to float32 (float64 for float64), or return them unchanged if the scaling has no effect.

    Source: NIfTI-1, scl_slope.
    """
    least = float(np.finfo(np.float64).eps)
    if abs(slope) <= least or (abs(slope - 1.0) <= least and abs(intercept) <= least):
        return values
    kind = np.float64 if values.dtype.itemsize == 8 and values.dtype.kind == "f" else np.float32
    return (values.astype(kind).astype(np.float64) * slope + intercept).astype(kind)


def _require_orthogonal(path: Path, axes: FloatArray) -> None:
    unit = axes / np.linalg.norm(axes, axis=0)
    shear = float(np.abs(unit.T @ unit - np.eye(3)).max())
    if shear > TOLERANCE:
        raise UnreadableFileError(
            f"{path}: the image axes are sheared ({np.degrees(np.arcsin(min(shear, 1.0))):.2f}° off "
            f"orthogonal in its sform); resample it with: nib-conform {path.name} straight_{path.name} "
            "--voxel-size 1 1 1"
        )


def _begin(path: Path, count: int) -> bytes:
    """Read the first bytes of a file, decompressed."""
    try:
        with gzip.open(path) if _is_packed(path) else path.open("rb") as stream:
            return stream.read(count)
    except (gzip.BadGzipFile, EOFError, zlib.error) as exc:
        raise UnreadableFileError(f"{path} is truncated or damaged ({exc}); copy it again") from exc


def _is_packed(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(2) == _GZIP


def _parse(path: Path, start: bytes, *, single: bool) -> ImageHeader:
    for order in "<>":
        stated = struct.unpack_from(f"{order}i", start)[0] if len(start) >= 4 else 0
        if len(start) < stated or stated not in _FIELDS:
            continue
        fields = {
            name: struct.unpack_from(order + form, start, at) for name, (form, at) in _FIELDS[stated].items()
        }
        return _checked(path, order, fields, 352 if stated == 348 else 544, single=single)
    raise UnreadableFileError(
        f"{path} is not a NIfTI file, or is truncated within its header ({len(start)} bytes)"
    )


def _checked(
    path: Path, order: str, fields: dict[str, tuple[Any, ...]], begin: int, *, single: bool
) -> ImageHeader:
    """Check that all fields are plausible and finite, and build the header."""
    dims = [int(size) for size in fields["dim"]]
    count = dims[0]
    used = dims[1 : count + 1] if 1 <= count <= 7 else []
    if not used or min(used) < 1 or max(used) > limits.AXIS or any(size > 1 for size in used[4:]):
        raise UnreadableFileError(
            f"{path}: its NIfTI header states the sizes {dims}; needed those of an image"
        )
    kind, (offset,) = int(fields["datatype"][0]), fields["vox_offset"]
    dtype = np.dtype(order + _TYPES.get(kind, "u1"))
    if kind not in _TYPES or fields["bitpix"] != (8 * dtype.itemsize,):
        raise UnreadableFileError(
            f"{path}: its data type is {kind} with {fields['bitpix'][0]} bits; needed real numbers"
        )
    if fields["magic"] not in ([(b"n+1\0",), (b"n+2\0",)] if single else [(b"ni1\0",), (b"ni2\0",)]):
        raise UnreadableFileError(
            f"{path} is not marked as NIfTI of its kind (single file or pair); convert it again"
        )
    sizes = np.array(fields["pixdim"][1 : min(count, 3) + 1])
    uses_qform, uses_sform = (code > 0 for code in fields["codes"])
    axes = np.array(fields["sform"]).reshape(3, 4)
    slope, intercept = fields["scaling"]
    scaling = (0.0, 0.0) if math.isnan(slope) else (slope, intercept)  # nibabel's header without scaling
    placed = [
        fields["pixdim"][0],
        *scaling,
        *(fields["qform"] if uses_qform else ()),
        *(axes.flat if uses_sform else ()),
    ]
    if not (np.abs(placed) < 1e12).all() or not ((sizes > 0) & (sizes < np.inf)).all():
        raise UnreadableFileError(
            f"{path}: its header holds voxel sizes ({sizes.tolist()}), an origin or a scale that are not "
            "finite or not positive; convert it again"
        )
    unit = int(fields["units"][0]) & 7
    if unit not in (0, _MM):
        raise UnreadableFileError(
            f"{path}: its unit of length is {_UNITS.get(unit, f'code {unit}')}; needed mm: save it in mm"
        )
    needed = math.prod(used) * dtype.itemsize
    if (
        not math.isfinite(offset)
        or offset % 1
        or not (begin if single else 0) <= offset <= limits.HEADER_BYTES
    ):
        raise UnreadableFileError(f"{path}: its voxels begin at byte {offset:g}; copy it again")
    if needed > limits.VOXEL_BYTES:
        raise UnreadableFileError(
            f"{path}: its header states {needed:.3g} bytes; at most {limits.VOXEL_BYTES:.3g} are read"
        )
    while len(used) > 3 and used[-1] == 1:
        used.pop()
    geometry = (np.zeros(3), np.ones(3), np.eye(3)) if count < 3 else _geometry(path, fields, used)
    step, time_unit = (
        float(f"{fields['pixdim'][4]:.7g}"),
        _TIME_UNITS.get(int(fields["units"][0]) & 0x38, "Hz, ppm or rad"),
    )
    (first,) = fields["toffset"]
    if len(used) == 4 and first and math.isfinite(first):
        log.warning("%s: its toffset, the time of its first volume, is %g, and is not used", path, first)
    return ImageHeader(
        tuple(used),
        dtype,
        1,
        3 if len(used) == 4 else None,
        *geometry,
        Storage((), int(offset)),
        times=uniform_times(step, used[3], time_unit, "pixdim[4]") if len(used) == 4 else None,
        scaling=scaling,
    )


def _geometry(
    path: Path, fields: dict[str, tuple[Any, ...]], sizes: list[int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return origin, spacing and direction in LPS of the sform, or of the qform if it alone is set.

    Raises:
        UnreadableFileError: neither is set, they differ, or the sform contradicts the voxel sizes.
    """
    uses_qform, uses_sform = (code > 0 for code in fields["codes"])
    sides = np.array(fields["pixdim"][1:4])
    if not uses_qform and not uses_sform:
        raise UnreadableFileError(
            f"{path} does not state how it is oriented (qform_code and sform_code are 0), and programs "
            "differ on which side is left; set its orientation, or convert the scanner's images again"
        )
    if not uses_sform:
        axes, origin = _qform(path, fields)
        return origin * _LPS, sides, axes * _LPS[:, None]
    sform = np.array(fields["sform"]).reshape(3, 4)
    length = np.linalg.norm(sform[:, :3], axis=0)
    if (length == 0).any():
        raise UnreadableFileError(f"{path}: an axis of its sform has no length; set its geometry again")
    _require_orthogonal(path, sform[:, :3])
    ends = np.array(sizes[:3]) - 1.0
    allowed = max(_SAME_MM, _SAME_SHARE * float(min(sides.min(), length.min())))
    apart_mm = np.abs((length - sides) * np.maximum(ends, 1.0))
    if apart_mm.max() > allowed or np.abs(length / sides - 1.0).max() > _SAME_SIDE:
        raise UnreadableFileError(
            f"{path}: its sform has voxels of {_text(length)} mm, its pixdim of {_text(sides)} mm; "
            "write it again with one voxel size, or take it from the scanner's images"
        )
    if uses_qform:
        corners = np.array(np.meshgrid(*((0.0, end) for end in ends))).reshape(3, -1)
        by_sform = sform[:, :3] @ corners + sform[:, 3:]
        axes, origin = _qform(path, fields)
        by_qform = axes @ (sides[:, None] * corners) + origin[:, None]
        apart = float(np.linalg.norm(by_sform - by_qform, axis=0).max())
        if apart > allowed:
            raise UnreadableFileError(
                f"{path} has two geometries that lie up to {apart:.1f} mm apart: its first voxel is at RAS "
                f"{_text(origin)} mm by the qform, {_text(sform[:, 3])} mm by the sform; keep the one that "
                f"the other images use: fslorient -copysform2qform {path.name}, or -copyqform2sform"
            )
    return sform[:, 3] * _LPS, sides, (sform[:, :3] / length) * _LPS[:, None]


def _qform(path: Path, fields: dict[str, tuple[Any, ...]]) -> tuple[FloatArray, FloatArray]:
    """Return unit axes (3, 3) and origin (3,) of the qform, RAS. Source: nifti1.h, method 2.

    Raises:
        UnreadableFileError: its quaternion is longer than 1.
    """
    b, c, d = fields["qform"][:3]
    if (length := math.hypot(b, c, d)) > 1.0 + TOLERANCE:
        raise UnreadableFileError(
            f"{path}: the quaternion of its qform has length {length:.3g} without its scalar part; needed at "
            "most 1: write its geometry again"
        )
    a = math.sqrt(max(1.0 - (b * b + c * c + d * d), 0.0))
    norm = math.hypot(a, b, c, d)
    turn = Rotation.from_quat(np.array([b, c, d, a]) / norm).as_matrix()
    handed = -1.0 if fields["pixdim"][0] < 0 else 1.0
    return turn * (1.0, 1.0, handed), np.array(fields["qform"][3:])


def _text(numbers: FloatArray) -> str:
    return " ".join(f"{number:.4g}" for number in numbers)
