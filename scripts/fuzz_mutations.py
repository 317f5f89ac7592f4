"""Ways to damage a file: by its numbers, its lines, its bytes, and inside packed or sealed content."""

import gzip
import hashlib
import io
import json
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable

NUMBERS = (
    "0 1 -1 2 3 255 256 65535 65536 2147483647 -2147483648 4294967296 1e9 1e10 99999999999",
    "9223372036854775808 nan inf -inf NaN 1e300 -1e300 1e-300 0.5 1e5 -0 0x10 1e 1,5",
    f"{'9' * 400} {'9' * 5000}",
)
WORDS = (
    "/dev/zero /etc/passwd ../x . .. LOCAL LIST True False null ~ {} [] %s%n %d RAS LPS m mm um RAST",
    "time list domain vector gzip raw ascii bzip2 big double block int64 uint8 MET_DOUBLE",
    "MET_UCHAR nan OK INVALID",
    f"\0 \u2028x \xe9 {'x' * 300} {'x' * 3000}",
)
ENDINGS = "x0 x-1 x00 x9999 :999999999 +999999999 /0 (1e400) (9999999999) e400 , ; : x"
"""Texts appended to a number, with which fields of WFDB's headers begin."""
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
ZEROS = 600 << 20
"""Bytes that pack to 600 kB, more than a reader may accept for such a file."""
_WORD = re.compile(rb"[A-Za-z_][\w.-]*")


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Make one to three changes to a file; packed or sealed content is opened for some of them."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = _opened(data, rng) if rng.random() < 0.5 else _changed(data, rng)
    return data


def _changed(data: bytes, rng: random.Random) -> bytes:
    head = data[:65536]
    is_text = b"\0" not in head[:200] and head[:200].isascii()
    ways = (
        (_number, _number, _number, _ending, _word, _line, _bytes, _cut)
        if is_text
        else (_bytes, _bytes, _field, _cut)
    )
    return rng.choice(ways)(data, rng)


def _replaced(data: bytes, pattern: re.Pattern[bytes], by: tuple[str, ...], rng: random.Random) -> bytes:
    places = [match.span() for match in pattern.finditer(data[:65536])]
    if not places:
        return _bytes(data, rng)
    begin, end = rng.choice(places[: rng.choice((20, len(places)))])
    return data[:begin] + rng.choice(" ".join(by).split(" ")).encode("utf-8") + data[end:]


def _number(data: bytes, rng: random.Random) -> bytes:
    return _replaced(data, _NUMBER, NUMBERS, rng)


def _ending(data: bytes, rng: random.Random) -> bytes:
    places = [match.end() for match in _NUMBER.finditer(data[:65536])]
    if not places:
        return _bytes(data, rng)
    at = rng.choice(places[: rng.choice((20, len(places)))])
    return data[:at] + rng.choice(ENDINGS.split(" ")).encode() + data[at:]


def _word(data: bytes, rng: random.Random) -> bytes:
    return _replaced(data, _WORD, WORDS, rng)


def _line(data: bytes, rng: random.Random) -> bytes:
    """Delete, repeat, move or empty a line."""
    lines = data.split(b"\n")
    i, j = rng.randrange(min(len(lines), 200)), rng.randrange(min(len(lines), 200))
    way = rng.randrange(4)
    if way == 0:
        del lines[i]
    elif way == 1:
        lines.insert(j, lines[i])
    elif way == 2:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i] = b""
    return b"\n".join(lines)


def _bytes(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 4, 16))):
        out[rng.randrange(rng.choice((min(len(out), 600), len(out))))] = rng.choice(
            (0, 255, 127, 128, rng.randrange(256))
        )
    return bytes(out)


def _field(data: bytes, rng: random.Random) -> bytes:
    """Put a number of 2, 4 or 8 bytes into the first bytes of a binary file."""
    form = rng.choice(("h", "i", "q", "f", "d"))
    value: float = rng.choice((0, 1, -1, 2, 99, 32767))
    if form in "fd":
        value = rng.choice((0.0, float("nan"), float("inf"), -1.0, 1e30, 1e-30))
    packed = struct.pack(rng.choice("<>") + form, value)
    at = rng.randrange(0, max(min(len(data) - 8, 700), 1))
    return data[:at] + packed + data[at + len(packed) :]


def _cut(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return rng.choice((data[:at], data[:at] + data[:at], data + data[at:], data[at:]))


def _opened(data: bytes, rng: random.Random) -> bytes:
    """Change packed content, and seal it again."""
    if data[:2] == b"\x1f\x8b":
        return (
            gzip.compress(_changed(gzip.decompress(data), rng)) if _unpacks(gzip.decompress, data) else data
        )
    if data[:2] == b"PK":
        return _model(data, rng) if _unpacks(_archive, data) else data
    if data[:5] == b"\x89MCAP":
        return _log(data, rng)
    place = data.find(b"ElementDataFile = LOCAL\n")
    if place > 0 and b"CompressedData = True" in data:
        body = data[place + 24 :]
        if _unpacks(zlib.decompress, body):
            return data[: place + 24] + zlib.compress(_changed(zlib.decompress(body), rng))
    return _changed(data, rng)


def _unpacks(unpack: Callable[[bytes], object], data: bytes) -> bool:
    try:
        unpack(data)
    except (OSError, ValueError, EOFError, zlib.error, zipfile.BadZipFile, RuntimeError, NotImplementedError):
        return False
    return True


def _archive(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if sum(member.file_size for member in archive.infolist()) >= ZEROS:
            raise zipfile.BadZipFile
        return {name: archive.read(name) for name in archive.namelist()}


def _array(content: bytes, rng: random.Random) -> bytes:
    """Make an array's header state another shape."""
    shapes = (
        "()",
        "(0,)",
        "(0, 1000000000000000000)",
        f"({'9' * 400},)",
        "(1e400,)",
        "(-1,)",
        "None",
        "(1,)",
    )
    shape = re.compile(rb"\([\d, ]*\)")
    return shape.sub(rng.choice(shapes).encode(), content[:200], count=1) + content[200:]


def _model(data: bytes, rng: random.Random) -> bytes:
    """Change a model's header or arrays, and correct the file's checksum."""
    members = _archive(data)
    name = rng.choice(sorted(members))
    members[name] = _array(members[name], rng) if rng.random() < 0.3 else _changed(members[name], rng)
    buffer = io.BytesIO()
    packed = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(buffer, "w", packed, compresslevel=1) as archive:
        for one, content in members.items():
            archive.writestr(one, content)
        if packed == zipfile.ZIP_DEFLATED and rng.random() < 0.01:
            with archive.open("zeros.npy", "w") as stream:
                for _ in range(ZEROS >> 20):
                    stream.write(bytes(1 << 20))
        archive.comment = b"dvf_ig sha256 " + b"0" * 64
    body = buffer.getvalue()[:-64]
    return body + hashlib.sha256(body).hexdigest().encode()


def _log(data: bytes, rng: random.Random) -> bytes:
    """Change a log inside a chunk or an attached file, and correct its sizes and digests."""
    from mcap.data_stream import RecordBuilder
    from mcap.exceptions import McapError
    from mcap.records import Attachment, Chunk, DataEnd, Footer, Metadata
    from mcap.stream_reader import MAGIC_SIZE, StreamReader
    from zstandard import ZstdError, compress, decompress

    records = []
    try:
        for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
            if isinstance(record, DataEnd):
                break
            records.append(record)
    except (McapError, ValueError, struct.error, OverflowError, MemoryError):
        pass  # a log that was cut off
    chosen = [record for record in records if isinstance(record, Chunk | Attachment)]
    if not chosen:
        return _changed(data, rng)
    changed = rng.choice(chosen)
    try:
        if isinstance(changed, Chunk):
            content = _changed(decompress(changed.data, changed.uncompressed_size), rng)
            changed.data, changed.uncompressed_size = compress(content), len(content)
            changed.uncompressed_crc = 0
        else:
            changed.data = _changed(changed.data, rng)
    except ZstdError:
        return _changed(data, rng)
    digests = {r.name: hashlib.sha256(r.data).hexdigest() for r in records if isinstance(r, Attachment)}
    builder = RecordBuilder()
    for record in records:
        if isinstance(record, Metadata) and record.name == "sha256":
            record.metadata = digests
        record.write(builder)
    DataEnd(0).write(builder)
    Footer(0, 0, 0).write(builder)
    mark = data[:MAGIC_SIZE]
    return b"".join((mark, builder.end(), mark))


def resealed(data: bytes) -> bytes:
    """Restore the digest in a model's header, which `_model` broke; other files stay unchanged."""
    from dvf_ig.core.errors import DvfIgError
    from dvf_ig.io.model.model_file import _digest, _unpack

    try:
        from pathlib import Path

        header, arrays = _unpack(Path("model"), data)
        header["sha256"] = _digest({k: v for k, v in header.items() if k != "sha256"}, arrays)
    except (DvfIgError, ValueError, TypeError):
        return data
    import numpy as np

    buffer = io.BytesIO()
    text = json.dumps(header, sort_keys=True).encode()
    np.savez(buffer, **{"header": np.frombuffer(text, np.uint8), **arrays})  # type: ignore[arg-type]
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.comment = b"dvf_ig sha256 " + b"0" * 64
    body = buffer.getvalue()[:-64]
    return body + hashlib.sha256(body).hexdigest().encode()
