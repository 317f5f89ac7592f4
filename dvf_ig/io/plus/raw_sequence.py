"""Parse a PLUS sequence file into header fields, per-frame fields, and the pixels as bytes.

MetaImage (`.mha`, `.mhd` with a separate data file) and NRRD (`.nrrd`, `.nhdr`). Both headers are text; the
per-frame fields are named Seq_FrameNNNN_<field>. `sequence_read` interprets the fields.
"""

import logging
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import AnyArray, BoolArray, FloatArray, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.file_within import file_within
from dvf_ig.io.inflate import inflated, require_size
from dvf_ig.io.reading import read_bytes

log = logging.getLogger(__name__)

_FRAME_FIELD = re.compile(r"Seq_Frame([0-9]{1,9})_(\S+)")
_TRANSFORM = re.compile(r"[A-Z][A-Za-z0-9]*To[A-Z][A-Za-z0-9]*Transform")
_DATA_FILE_LINE = re.compile(rb"^ElementDataFile[ \t]*=[ \t]*([^\r\n]*)(\r\n|\n|\r|\Z)", re.MULTILINE)
_UINT8 = {"MET_UCHAR", "uchar", "unsigned char", "uint8", "uint8_t"}


@dataclass(frozen=True, slots=True)
class RawSequence:
    """Content of a sequence file, not yet interpreted.

    Attributes:
        fields: header fields by name.
        frame_fields: per-frame fields: name, then frame index, then text.
        columns, rows: image size; 0 without images.
        frames: number of frames.
        pixels: rows·columns·frames bytes, uint8, x fastest; empty without images.
    """

    fields: dict[str, str]
    frame_fields: dict[str, dict[int, str]]
    columns: int
    rows: int
    frames: int
    pixels: memoryview

    @property
    def pixel_type(self) -> str:
        """Pixel type as stated in the header: ElementType in MetaImage, type in NRRD."""
        return self.fields.get("ElementType", self.fields.get("type", "of no stated type"))

    @property
    def is_uint8(self) -> bool:
        """True if the pixels are 8-bit, or there are none."""
        return not self.columns or self.pixel_type in _UINT8

    @property
    def image_type(self) -> str:
        """Type of the images as the header states it; "" if it does not."""
        names = ("UltrasoundImageType", "ultrasound image type")
        return next((self.fields[name] for name in names if name in self.fields), "")

    def numbers(self, name: str) -> FloatArray | None:
        """Parse (frames,) values of a per-frame field, NaN for frames without it; None if no frame has it.

        Also None if a value is not a finite number.
        """
        texts = self.frame_fields.get(name, {})
        try:
            values = np.array([float(texts.get(i, "nan")) for i in range(self.frames)])
            finite = bool(np.isfinite([float(text) for text in texts.values()]).all())
        except ValueError:
            return None
        return values if texts and finite else None

    @property
    def bare(self) -> BoolArray:
        """Mark (frames,) frames without a time stamp; none if no frame has one."""
        stamped = self.frame_fields.get("Timestamp", {})
        return np.array([bool(stamped) and i not in stamped for i in range(self.frames)])

    @property
    def orientation(self) -> str:
        """Orientation of the stored images as the header states it; "" if it does not."""
        names = ("UltrasoundImageOrientation", "ultrasound image orientation")
        return next((self.fields[name] for name in names if name in self.fields), "")


@dataclass(slots=True)
class _Header:
    path: Path
    fields: dict[str, str] = field(default_factory=dict)
    frame_fields: dict[str, dict[int, str]] = field(default_factory=dict)

    def add(self, name: str, value: str) -> None:
        """Add a field.

        Raises:
            UnreadableFileError: it has another value already.
        """
        match = _FRAME_FIELD.fullmatch(name)
        fields: dict[Any, str] = self.frame_fields.setdefault(match[2], {}) if match else self.fields
        if fields.setdefault(int(match[1]) if match else name, value) != value:
            raise UnreadableFileError(
                f"{self.path}: its header states {name[:60]} twice, with different values; correct it, or "
                "record again"
            )

    def complete(self, frames: int) -> None:
        """Give each frame the transforms of the whole file, and its unfiltered stamp if it has no other."""
        unfiltered = self.frame_fields.get("UnfilteredTimestamp", {})
        if not self.frame_fields.get("Timestamp") and len(unfiltered) == frames:
            log.warning("%s has no Timestamp; its UnfilteredTimestamp is used", self.path)
            self.frame_fields["Timestamp"] = unfiltered
        for name in [name for name in self.fields if _TRANSFORM.fullmatch(name)]:
            own = self.frame_fields.setdefault(name, {})
            if not own:
                own.update(dict.fromkeys(range(frames), self.fields[name]))
            elif set(own.values()) != {self.fields[name]}:
                raise UnreadableFileError(
                    f"{self.path}: its header states {name[:60]} for all frames, and another for some; "
                    "correct it"
                )

    def require_frames(self, frames: int) -> None:
        """Raise UnreadableFileError for a field of a frame beyond the `frames` that the header counts."""
        for name, values in self.frame_fields.items():
            if values and (last := max(values)) >= frames:
                raise UnreadableFileError(
                    f"{self.path}: a field of frame {last} ({name}), but the header counts {frames} frames"
                )


def read_raw_sequence(path: Path, *, pixels: bool = True) -> RawSequence:
    """Parse a sequence file of either format, identified by its first bytes.

    Args:
        path: the file.
        pixels: False skips the pixels, of whatever type, without checks.
    Raises:
        UnreadableFileError: neither format, a damaged header, pixels other than uint8, or fewer pixels than
            the header states.
    """
    data = read_bytes(path, "a tracked sequence")
    return (_read_nrrd if data.startswith(b"NRRD") else _read_metaimage)(path, data, pixels)


def _read_metaimage(path: Path, data: bytes, read_pixels: bool) -> RawSequence:
    end = _DATA_FILE_LINE.search(data)
    if end is None:
        raise UnreadableFileError(
            f"{path} is not a sequence metafile: no ElementDataFile line in its {len(data)} bytes; "
            "needed a PLUS .igs.mha, .igs.mhd or .igs.nrrd file"
        )
    header = _Header(path)
    for line in _header_text(path, data[: end.start()]).splitlines():
        name, equals, value = line.partition("=")
        if equals:
            header.add(name.strip(), value.strip())
        elif line.strip():
            raise UnreadableFileError(f"{path}: header line '{line.strip()[:60]}' is not 'name = value'")
    fields = header.fields
    shape = _shape(header, "DimSize", fields.get("Kinds", ""), ("HeaderSize",), data)
    if 0 in shape or not read_pixels:
        return _without_pixels(path, header, shape, len(data))
    _require_uint8(path, fields.get("ElementType"), fields.get("ElementNumberOfChannels", "1"))
    if fields.get("BinaryData", "True").lower() != "true":
        raise UnreadableFileError(f"{path}: the pixels are stored as text; save the sequence as binary data")
    payload = _payload(path, data, end.end(), end[1].decode("utf-8", "replace").strip())
    packed = fields.get("CompressedData", "False").lower() == "true"
    return _with_pixels(path, header, shape, payload, packed=packed)


def _shape(
    header: _Header, name: str, kinds: str, skips: tuple[str, ...], data: bytes
) -> tuple[int, int, int]:
    """Return columns, rows and frames by the field `name`, and complete the fields of the frames.

    Raises:
        UnreadableFileError: they do not fit the fields of frames, or bytes are to be skipped.
    """
    path, fields = header.path, header.fields
    shape = _layout(path, _integers(path, name, fields.get(name)), kinds.split())
    header.require_frames(shape[2])
    if shape[2] <= len(data):
        header.complete(shape[2])
    _require_nothing_skipped(path, fields, skips)
    return shape


def _with_pixels(
    path: Path, header: _Header, shape: tuple[int, int, int], payload: memoryview, *, packed: bool
) -> RawSequence:
    expected = shape[0] * shape[1] * shape[2]
    pixels = _inflated(path, payload, expected) if packed else payload
    require_size(path, len(pixels), expected)
    return RawSequence(header.fields, header.frame_fields, *shape, pixels)


def _without_pixels(path: Path, header: _Header, shape: tuple[int, int, int], size: int) -> RawSequence:
    """Build a sequence of poses alone, or whose pixels are not read."""
    columns, rows, frames = shape
    _require_plausible(path, frames, size)
    if 0 in shape:
        columns = rows = 0
    return RawSequence(header.fields, header.frame_fields, columns, rows, frames, memoryview(b""))


def _read_nrrd(path: Path, data: bytes, read_pixels: bool) -> RawSequence:
    end = re.search(rb"\r?\n\r?\n", data)
    stop, start = (end.start(), end.end()) if end else (len(data), len(data))
    header = _Header(path)
    for line in _header_text(path, data[:stop]).splitlines()[1:]:
        if line.startswith("#") or not line.strip():
            continue
        name, colon, value = line.partition(":")
        if not colon:
            raise UnreadableFileError(f"{path}: header line '{line.strip()[:60]}' is not 'name: value'")
        header.add(name.strip(), value.removeprefix("=").strip())
    fields = header.fields
    skips = ("line skip", "lineskip", "byte skip", "byteskip")
    shape = _shape(header, "sizes", fields.get("kinds", ""), skips, data)
    if 0 in shape or not read_pixels:
        return _without_pixels(path, header, shape, len(data))
    _require_uint8(path, fields.get("type"), "1")
    payload = _payload(path, data, start, fields.get("data file", fields.get("datafile", "LOCAL")))
    encoding = fields.get("encoding", "raw").lower()
    if encoding not in ("raw", "gzip", "gz"):
        raise UnreadableFileError(f"{path}: encoding '{encoding}' is not supported; save it as raw or gzip")
    return _with_pixels(path, header, shape, payload, packed=encoding != "raw")


def _require_nothing_skipped(path: Path, fields: dict[str, str], names: tuple[str, ...]) -> None:
    """Refuse a header after which bytes are to be skipped: which of them are pixels is not certain."""
    for name in names:
        if fields.get(name, "0").strip() not in ("0", ""):
            raise UnreadableFileError(
                f"{path}: {name} is '{fields[name][:20]}'; needed 0, pixels right after the header: save it "
                "again"
            )


def _header_text(path: Path, header: bytes) -> str:
    try:
        return header.decode("utf-8")
    except UnicodeDecodeError as exc:
        raise UnreadableFileError(
            f"{path} is not a tracked sequence: its header holds bytes that are not text"
        ) from exc


def _integers(path: Path, name: str, text: str | None) -> list[int]:
    words = (text or "").split()
    if any(re.fullmatch(r"[-+]?[0-9]{1,18}", word) is None for word in words):
        raise UnreadableFileError(f"{path}: {name} is '{(text or '')[:60]}'; needed whole numbers")
    sizes = [int(word) for word in words]
    if not sizes or min(sizes) < 0 or len(sizes) > 4:
        raise UnreadableFileError(
            f"{path}: {name} is '{(text or 'absent')[:60]}'; needed image size and frame count"
        )
    return sizes


def _layout(path: Path, sizes: list[int], kinds: list[str]) -> tuple[int, int, int]:
    """Derive columns, rows and frames from the sizes; without a frame axis there is one frame."""
    if kinds and kinds[0] in ("list", "time", "vector") and len(sizes) > 2:
        raise UnreadableFileError(
            f"{path}: the axes are {' '.join(kinds)}; needed columns, rows, frames (domain domain list)"
        )
    if len(sizes) == 4 and sizes[2] <= 1:
        sizes = [sizes[0], sizes[1], sizes[3]]
    if len(sizes) == 2:
        sizes = [*sizes, 1]
    if len(sizes) != 3:
        raise UnreadableFileError(
            f"{path}: {len(sizes)} axes of sizes {sizes}; needed columns, rows and frames of 2-D images"
        )
    columns, rows, frames = sizes
    if max(columns, rows) > limits.AXIS:
        raise UnreadableFileError(f"{path}: images of {columns} x {rows} pixels; copy it again")
    if frames == 0:
        raise UnreadableFileError(f"{path} holds no frames; record again")
    return (columns, rows, frames) if columns and rows else (0, 0, frames)


def _require_plausible(path: Path, frames: int, size: int) -> None:
    """Refuse more frames than bytes: a damaged count must not reserve memory."""
    if frames > size:
        raise UnreadableFileError(f"{path}: its header counts {frames} frames, the file has {size} bytes")


def _require_uint8(path: Path, kind: str | None, channels: str) -> None:
    if kind not in _UINT8 or channels.strip() != "1":
        raise UnreadableFileError(
            f"{path}: pixels are {kind or 'of no stated type'} with {channels} channel(s); "
            "needed 8-bit B-mode (MET_UCHAR, 1 channel): scan-convert RF data and reduce colour to grey first"
        )


def _payload(path: Path, data: bytes, start: int, name: str) -> memoryview:
    """Return the pixel bytes: the rest of this file, or the separate file that the header names."""
    if name.upper() == "LOCAL":
        return memoryview(data)[start:]
    if name.upper().startswith("LIST") or "%" in name:
        raise UnreadableFileError(f"{path}: pixels are spread over several files; save it as one sequence")
    return memoryview(read_bytes(file_within(path.parent, name, path), f"the pixel data of {path.name}"))


def _inflated(path: Path, payload: memoryview, expected: int) -> memoryview:
    if expected > limits.FILE_BYTES:
        raise UnreadableFileError(f"{path}: its header states {expected} bytes of images; split it")
    return inflated(path, payload, expected).data


UNKNOWN = "XX"
_ORIENTATION = re.compile(r"([MU][FN]|[FN][MU])[AD]?")


def require_orientation(path: Path, text: str) -> str:
    """Return an orientation that PLUS writes for 2-D images, or UNKNOWN.

    Raises:
        UnreadableFileError: another one, for example of a volume.
    """
    word = text.strip().upper()
    if word in ("", "XX", "XXX"):
        return UNKNOWN
    if _ORIENTATION.fullmatch(word) is None:
        raise UnreadableFileError(
            f"{path}: UltrasoundImageOrientation is '{text[:20]}'; needed that of 2-D images (MF, UF, MN "
            "or UN): save it again as a sequence of images"
        )
    return word


def turned_orientation(stored: str) -> str | None:
    """Return the orientation after `turned_images`; None if images in `stored` are not turned."""
    return f"MF{stored[2:]}" if stored[:2] in ("UF", "MN", "UN") else None


def turned_images(images: AnyArray, stored: str) -> AnyArray:
    """Turn (n, rows, columns) images in UF, MN or UN to MF; others stay as they are."""
    if turned_orientation(stored) is None:
        return images
    flips = tuple(axis for axis, letter in ((1, "N"), (2, "U")) if letter in stored[:2])
    return np.ascontiguousarray(np.flip(images, flips))


def turned_points(points_px: FloatArray, stored: str, shape: tuple[int, int]) -> FloatArray:
    """Turn (…, 2) positions, column and row of the stored image, as `turned_images` does with the image.

    Args:
        shape: rows and columns of the image.
    """
    points = np.array(points_px)
    for axis, letter in ((0, "U"), (1, "N")):
        if turned_orientation(stored) is not None and letter in stored[:2]:
            points[..., axis] = shape[1 - axis] - 1 - points[..., axis]
    return points
