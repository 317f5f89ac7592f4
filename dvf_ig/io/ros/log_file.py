"""MCAP files with ROS 2 messages and attachments: `ros2 bag`, Foxglove and PlotJuggler open them."""

import hashlib
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import IO, Any

from dvf_ig.core.errors import MissingDependencyError, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.reading import reading
from dvf_ig.io.writing.atomic import atomic_file

from .messages import Message, nanoseconds, typestore

MARK = b"\x89MCAP0\r\n"
WHAT = "an MCAP log"
DIGESTS, COUNTS = "sha256", "messages"
"""Metadata of a log: of each attached file; how many messages each topic has. The CRC of chunks is checked,
but not that of attachments."""

UNFINISHED = "unfinished.mcap"
"""Ending of the name of a log that is being written, or was when its program was killed."""
MOST_PACKED = 100
"""Bytes of messages for each byte of a log: ultrasound packs to a third, a sector's black margins to more."""
LEAST_UNPACKED_BYTES = 256 << 20
"""That many are read of any log: images that are all alike pack to nothing."""


class LogWriter:
    """Appends messages and attachments to an open MCAP file (see `written_log`).

    Args:
        chunk_bytes: messages are written when they have come to so much.
    """

    def __init__(self, stream: IO[bytes], chunk_bytes: int = 1024 * 1024) -> None:
        from mcap.writer import Writer

        self._writer = Writer(stream, chunk_size=chunk_bytes)
        self._writer.start(profile="ros2", library="dvf_ig")
        self._types: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._digests: dict[str, str] = {}
        self._counts: dict[str, int] = {}

    def write(self, topic: str, kind: str, t_s: float, message: Message) -> None:
        """A message of type `kind` that belongs to `t_s`."""
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._type(kind))
        stamp = nanoseconds(t_s)
        data = bytes(typestore().serialize_cdr(message, kind))
        self._writer.add_message(self._channels[topic], stamp, data, stamp)
        self._counts[topic] = self._counts.get(topic, 0) + 1

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """A file within the log."""
        self._writer.add_attachment(0, 0, name, media_type, data)
        self._digests[name] = hashlib.sha256(data).hexdigest()

    def end_attachments(self) -> None:
        """Write what the reader compares them with: they can be read from then on, whatever happens."""
        self._writer.add_metadata(DIGESTS, self._digests)
        self._digests = {}

    def note(self, name: str, value: int) -> None:
        """A number that belongs to the whole log."""
        self._writer.add_metadata(name, {name: str(value)})

    def finish(self) -> None:
        """Write what the reader compares, and the index; nothing may follow."""
        if self._digests:
            self.end_attachments()
        self._writer.add_metadata(COUNTS, {topic: str(n) for topic, n in self._counts.items()})
        self._writer.finish()

    def _type(self, kind: str) -> int:
        if kind not in self._types:
            text, _ = typestore().generate_msgdef(kind, ros_version=2)
            self._types[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        return self._types[kind]


@contextmanager
def written_log(path: Path) -> Iterator[LogWriter]:
    """A log that is written whole or not at all.

    Raises:
        MissingDependencyError: mcap or rosbags is absent.
        OutputError: not writable.
    """
    require_log_packages()
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        log = LogWriter(stream)
        yield log
        log.finish()


def require_log_packages() -> None:
    """Raise MissingDependencyError where mcap or rosbags is absent."""
    typestore()
    _require_mcap()


@contextmanager
def opened_log(path: Path) -> Iterator["LogReader"]:
    """A log to read from; one that is named as unfinished may end anywhere.

    Raises:
        MissingDependencyError: mcap or rosbags is absent.
        UnreadableFileError: absent, not MCAP, cut off or damaged.
    """
    require_log_packages()
    with reading(path, WHAT), path.open("rb") as stream:
        if path.stat().st_size > limits.FILE_BYTES or stream.read(len(MARK)) != MARK:
            raise UnreadableFileError(f"{path} is not {WHAT}, or larger than {limits.FILE_BYTES:.3g} bytes")
        stream.seek(0)
        try:
            yield CutLogReader(stream, path) if path.name.endswith(UNFINISHED) else LogReader(stream, path)
        except UnreadableFileError:
            raise
        except _damage() as exc:
            raise UnreadableFileError(f"{path} is cut off or damaged ({exc}); copy it again") from exc


class LogReader:
    """Messages and attachments of an open log (see `opened_log`)."""

    whole = True
    """Whether it was finished."""

    def __init__(self, stream: IO[bytes], path: Path) -> None:
        self._stream = stream
        self._path = path
        self._size = os.fstat(stream.fileno()).st_size

    def attachments(self) -> dict[str, bytes]:
        """Every file within the log by its name.

        Raises:
            UnreadableFileError: a name that is there twice, or a file that is not the one that was attached.
        """
        found: dict[str, bytes] = {}
        for one in self._of_kind("Attachment"):
            if one.name in found:
                raise UnreadableFileError(f"{self._path} holds two files of the name {one.name[:80]!r}")
            found[one.name] = one.data
        if self._metadata.get(DIGESTS, {}) != {
            name: hashlib.sha256(data).hexdigest() for name, data in found.items()
        }:
            raise UnreadableFileError(
                f"{self._path}: its attached files are not those that were written; copy it again"
            )
        return found

    def messages(self, kinds: Mapping[str, str]) -> Iterator[tuple[str, Message]]:
        """(topic, message) of the wanted topics, each in the order in which it was written.

        Args:
            kinds: of each topic, its type.
        Raises:
            UnreadableFileError: a topic is of another type, or lacks messages.
        """
        store = typestore()
        counts = dict.fromkeys(kinds, 0)
        schemas: dict[int, Any] = {}
        channels: dict[int, Any] = {}
        for name, found in self._unpacked():
            if name == "Schema":
                schemas[found.id] = found
            elif name == "Channel":
                channels[found.id] = found
            elif name == "Message":
                channel = channels[found.channel_id]
                kind = kinds.get(channel.topic)
                if kind is None:
                    continue
                schema = schemas.get(channel.schema_id)
                if schema is None or schema.name != kind:
                    raise UnreadableFileError(f"{self._path}: {channel.topic} is not of type {kind}")
                counts[channel.topic] += 1
                yield channel.topic, store.deserialize_cdr(found.data, kind)
        self._require_all(counts)

    def number(self, name: str) -> int | None:
        """A number that was noted; None where none was."""
        text = self._metadata.get(name, {}).get(name, "")
        return int(text) if text.isdecimal() else None

    def _require_all(self, counts: Mapping[str, int]) -> None:
        stated = self._metadata.get(COUNTS, {})
        if any(stated.get(topic, "0") != str(n) for topic, n in counts.items()):
            raise UnreadableFileError(f"{self._path} lacks messages that were written; copy it again")

    @cached_property
    def _metadata(self) -> dict[str, dict[str, str]]:
        found: dict[str, dict[str, str]] = {}
        for record in self._of_kind("Metadata"):
            found[record.name] = found.get(record.name, {}) | record.metadata
        return found

    def _of_kind(self, wanted: str) -> Iterator[Any]:
        return (one for one in self._records() if type(one).__name__ == wanted)

    def _records(self) -> Iterator[Any]:
        """Every record in the order of the file, whose types have the names of the format's specification.

        The index at the end is not used: it may lead to what lies in no record.
        """
        from mcap.stream_reader import StreamReader

        self._stream.seek(0)
        reader = StreamReader(
            self._stream, emit_chunks=True, validate_crcs=True, record_size_limit=self._size
        )
        yield from reader.records

    def _unpacked(self) -> Iterator[tuple[str, Any]]:
        """Each record with the name of its type; those of chunks in place of the chunks."""
        from mcap.stream_reader import breakup_chunk

        held = 0
        for record in self._records():
            if type(record).__name__ != "Chunk":
                yield type(record).__name__, record
                continue
            held += self._size_of(record)
            if held > max(LEAST_UNPACKED_BYTES, MOST_PACKED * self._size):
                raise UnreadableFileError(
                    f"{self._path} states {held} bytes of messages and has {self._size}; at most "
                    f"{MOST_PACKED} times as many are read: copy it again"
                )
            for one in breakup_chunk(record, validate_crc=True):
                yield type(one).__name__, one

    def _size_of(self, chunk: Any) -> int:
        """Bytes that a chunk unpacks to.

        Raises:
            UnreadableFileError: packed otherwise than we do, or what it states is not what it holds.
        """
        import zstandard

        if chunk.compression not in ("", "zstd"):
            raise UnreadableFileError(
                f"{self._path}: its messages are packed as {chunk.compression[:20]!r}; needed zstd"
            )
        packed = chunk.compression == "zstd"
        held = zstandard.frame_content_size(chunk.data) if packed else len(chunk.data)
        if held != chunk.uncompressed_size:
            raise UnreadableFileError(
                f"{self._path} states a chunk of {chunk.uncompressed_size} bytes that holds {held}; copy it "
                "again"
            )
        return int(held)


class CutLogReader(LogReader):
    """Reader of a log that ends anywhere: what was written whole, in order, and nothing after damage."""

    whole = False

    def _records(self) -> Iterator[Any]:
        with suppress(*_damage()):
            yield from super()._records()

    def _unpacked(self) -> Iterator[tuple[str, Any]]:
        with suppress(*_damage()):
            yield from super()._unpacked()

    def _require_all(self, counts: Mapping[str, int]) -> None:
        """Nobody had counted."""


def _damage() -> tuple[type[Exception], ...]:
    """What mcap, zstandard and rosbags raise on damaged files."""
    from mcap.exceptions import McapError
    from rosbags.serde import SerdeError
    from zstandard import ZstdError

    return (
        McapError,
        SerdeError,
        ZstdError,
        struct.error,
        ValueError,
        TypeError,
        MemoryError,
        RuntimeError,
        LookupError,
        AttributeError,
        ArithmeticError,
        AssertionError,
    )


def _require_mcap() -> None:
    try:
        import mcap  # noqa: F401
    except ImportError as exc:
        raise MissingDependencyError(
            'session logs need the packages mcap and rosbags; install them with: pip install "dvf-ig[log]"'
        ) from exc
