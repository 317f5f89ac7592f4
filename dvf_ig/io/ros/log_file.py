"""Read and write MCAP files with ROS 2 messages and attachments, for `ros2 bag`, Foxglove and PlotJuggler."""

import hashlib
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import IO, Any

from dvf_ig.core.errors import InvalidInputError, MissingDependencyError, UnreadableFileError, install_extra
from dvf_ig.io import limits
from dvf_ig.io.reading import reading
from dvf_ig.io.writing.atomic import atomic_file

from .messages import Message, nanoseconds, typestore

MARK = b"\x89MCAP0\r\n"
WHAT = "an MCAP log"
DIGESTS, COUNTS = "sha256", "messages"
"""Metadata keys of a log: digest of each attached file; number of messages per topic. The MCAP library checks
the CRC of chunks, but not of attachments."""

UNFINISHED = "unfinished.mcap"
"""Name ending of a log that is being written, or was when its program was killed."""
MOST_PACKED = 100
"""Most message bytes per byte of a log: ultrasound compresses to a third, its black margins further."""
LEAST_UNPACKED_BYTES = 256 << 20
"""Bytes that are read of any log, because identical images compress to almost nothing."""


class LogWriter:
    """Appends messages and attachments to an open MCAP file (see `written_log`).

    Args:
        chunk_bytes: size at which collected messages are written.
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
        """Write a message of type `kind` that belongs to `t_s`."""
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._type(kind))
        stamp = nanoseconds(t_s)
        data = bytes(typestore().serialize_cdr(message, kind))
        self._writer.add_message(self._channels[topic], stamp, data, stamp)
        self._counts[topic] = self._counts.get(topic, 0) + 1

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file to the log."""
        self._writer.add_attachment(0, 0, name, media_type, data)
        self._digests[name] = hashlib.sha256(data).hexdigest()

    def end_attachments(self) -> None:
        """Write the digests of the attachments: from then on they can be read, whatever happens."""
        self._writer.add_metadata(DIGESTS, self._digests)
        self._digests = {}

    def note(self, name: str, value: int) -> None:
        """Write a number that belongs to the whole log."""
        self._writer.add_metadata(name, {name: str(value)})

    def finish(self) -> None:
        """Write the message counts and the index; nothing may follow."""
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
    """Open a log that is written as a whole or not at all.

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
    """Raise MissingDependencyError if mcap or rosbags is absent."""
    typestore()
    _require_mcap()


@contextmanager
def opened_log(path: Path) -> Iterator["LogReader"]:
    """Open a log for reading; one that is named as unfinished may end anywhere.

    Raises:
        MissingDependencyError: mcap or rosbags is absent.
        UnreadableFileError: absent, not MCAP, truncated or damaged.
    """
    require_log_packages()
    with reading(path, WHAT), path.open("rb") as stream:
        if path.stat().st_size > limits.FILE_BYTES or stream.read(len(MARK)) != MARK:
            raise UnreadableFileError(f"{path} is not {WHAT}, or larger than {limits.FILE_BYTES:.3g} bytes")
        stream.seek(0)
        try:
            yield CutLogReader(stream, path) if path.name.endswith(UNFINISHED) else LogReader(stream, path)
        except InvalidInputError:
            raise  # a value that no session has; `reading` names the file
        except _damage() as exc:
            raise UnreadableFileError(f"{path} is truncated or damaged ({exc}); copy it again") from exc


class LogReader:
    """Messages and attachments of an open log (see `opened_log`)."""

    whole = True
    """True if the log was finished."""

    def __init__(self, stream: IO[bytes], path: Path) -> None:
        self._stream = stream
        self._path = path
        self._size = os.fstat(stream.fileno()).st_size

    def attachments(self) -> dict[str, bytes]:
        """Read every attached file by its name.

        Raises:
            UnreadableFileError: a repeated name, or a file that differs from the one that was attached.
        """
        files: dict[str, bytes] = {}
        for one in self._of_kind("Attachment"):
            if one.name in files:
                raise UnreadableFileError(
                    f"{self._path} holds two files named {one.name[:80]!r}; copy it again"
                )
            files[one.name] = one.data
        if self._metadata.get(DIGESTS, {}) != {
            name: hashlib.sha256(data).hexdigest() for name, data in files.items()
        }:
            raise UnreadableFileError(
                f"{self._path}: its attached files are not those that were written; copy it again"
            )
        return files

    def messages(self, kinds: Mapping[str, str]) -> Iterator[tuple[str, Message]]:
        """Yield (topic, message) of the requested topics, each in the order of writing.

        Args:
            kinds: type of each topic.
        Raises:
            UnreadableFileError: a topic is of another type, or lacks messages.
        """
        store = typestore()
        counts = dict.fromkeys(kinds, 0)
        schemas: dict[int, Any] = {}
        channels: dict[int, Any] = {}
        for name, record in self._unpacked():
            if name == "Schema":
                schemas[record.id] = record
            elif name == "Channel":
                channels[record.id] = record
            elif name == "Message":
                channel = channels[record.channel_id]
                kind = kinds.get(channel.topic)
                if kind is None:
                    continue
                schema = schemas.get(channel.schema_id)
                if schema is None or schema.name != kind:
                    raise UnreadableFileError(f"{self._path}: {channel.topic} is not of type {kind}")
                counts[channel.topic] += 1
                yield channel.topic, store.deserialize_cdr(record.data, kind)
        self._require_all(counts)

    def number(self, name: str) -> int | None:
        """Return a number that `note` wrote; None without one."""
        text = self._metadata.get(name, {}).get(name, "")
        return int(text) if text.isdecimal() else None

    def _require_all(self, counts: Mapping[str, int]) -> None:
        stated = self._metadata.get(COUNTS, {})
        if any(stated.get(topic, "0") != str(n) for topic, n in counts.items()):
            raise UnreadableFileError(f"{self._path} lacks messages that were written; copy it again")

    @cached_property
    def _metadata(self) -> dict[str, dict[str, str]]:
        entries: dict[str, dict[str, str]] = {}
        for record in self._of_kind("Metadata"):
            entries[record.name] = entries.get(record.name, {}) | record.metadata
        return entries

    def _of_kind(self, kind: str) -> Iterator[Any]:
        return (one for one in self._records() if type(one).__name__ == kind)

    def _records(self) -> Iterator[Any]:
        """Yield every record in the order of the file; their types are named as in the MCAP specification.

        The index at the end is not used: it may point to bytes outside any record.
        """
        from mcap.stream_reader import StreamReader

        self._stream.seek(0)
        reader = StreamReader(
            self._stream, emit_chunks=True, validate_crcs=True, record_size_limit=self._size
        )
        yield from reader.records

    def _unpacked(self) -> Iterator[tuple[str, Any]]:
        """Yield each record with the name of its type; chunks are replaced by their records."""
        from mcap.stream_reader import breakup_chunk

        unpacked = 0
        for record in self._records():
            if type(record).__name__ != "Chunk":
                yield type(record).__name__, record
                continue
            unpacked += self._size_of(record)
            if unpacked > max(LEAST_UNPACKED_BYTES, MOST_PACKED * self._size):
                raise UnreadableFileError(
                    f"{self._path} states {unpacked} bytes of messages and has {self._size}; at most "
                    f"{MOST_PACKED} times as many can be read: copy it again"
                )
            for one in breakup_chunk(record, validate_crc=True):
                yield type(one).__name__, one

    def _size_of(self, chunk: Any) -> int:
        """Return the bytes that a chunk decompresses to.

        Raises:
            UnreadableFileError: another compression than ours, or a wrong stated size.
        """
        import zstandard

        if chunk.compression not in ("", "zstd"):
            raise UnreadableFileError(
                f"{self._path}: its messages are compressed with {chunk.compression[:20]!r}; needed zstd"
            )
        packed = chunk.compression == "zstd"
        size = zstandard.frame_content_size(chunk.data) if packed else len(chunk.data)
        if size != chunk.uncompressed_size:
            raise UnreadableFileError(
                f"{self._path} states a chunk of {chunk.uncompressed_size} bytes that holds {size}; copy it "
                "again"
            )
        return int(size)


class CutLogReader(LogReader):
    """Reader of a log that may end anywhere: complete records in order, and nothing after damage."""

    whole = False

    def _records(self) -> Iterator[Any]:
        with suppress(*_damage()):
            yield from super()._records()

    def _unpacked(self) -> Iterator[tuple[str, Any]]:
        with suppress(*_damage()):
            yield from super()._unpacked()

    def _require_all(self, counts: Mapping[str, int]) -> None:
        """Skip the check: an unfinished log has no counts."""


def _damage() -> tuple[type[Exception], ...]:
    """List the exceptions that mcap, zstandard and rosbags raise on damaged files."""
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
            f"session logs need the packages mcap and rosbags; {install_extra('log')}"
        ) from exc
