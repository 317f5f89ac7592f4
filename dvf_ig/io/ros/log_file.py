"""MCAP files with ROS 2 messages and attachments: `ros2 bag`, Foxglove and PlotJuggler open them."""

import hashlib
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from dvf_ig.core.errors import MissingDependencyError, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.atomic import atomic_file
from dvf_ig.io.reading import reading

from .messages import Message, nanoseconds, typestore

MARK = b"\x89MCAP0\r\n"
WHAT = "an MCAP log"
DIGESTS, COUNTS = "sha256", "messages"
"""Metadata of a log: of each attached file; how many messages each topic has. mcap's reader checks the CRC of
chunks, but not of attachments nor of the index, by which it finds the messages of a topic."""

_DAMAGE = (struct.error, MemoryError, RuntimeError, LookupError, AttributeError, ArithmeticError)
"""What mcap and rosbags raise on damaged files, besides ValueError."""


class LogWriter:
    """Appends messages and attachments to an open MCAP file (see `written_log`)."""

    def __init__(self, stream: IO[bytes]) -> None:
        from mcap.writer import Writer

        self._writer = Writer(stream)
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

    def finish(self) -> None:
        """Write what the reader compares, and the index; nothing may follow."""
        self._writer.add_metadata(DIGESTS, self._digests)
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
    typestore()
    _require_mcap()
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        log = LogWriter(stream)
        yield log
        log.finish()


@contextmanager
def opened_log(path: Path) -> Iterator["LogReader"]:
    """A log to read from.

    Raises:
        MissingDependencyError: mcap or rosbags is absent.
        UnreadableFileError: absent, not MCAP, cut off or damaged.
    """
    typestore()
    _require_mcap()
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    with reading(path, WHAT), path.open("rb") as stream:
        if path.stat().st_size > limits.FILE_BYTES or stream.read(len(MARK)) != MARK:
            raise UnreadableFileError(f"{path} is not {WHAT}, or larger than {limits.FILE_BYTES:.3g} bytes")
        stream.seek(0)
        try:
            yield LogReader(stream, path)
        except (McapError, ZstdError, *_DAMAGE) as exc:
            raise UnreadableFileError(f"{path} is cut off or damaged ({exc}); copy it again") from exc
        except ValueError as exc:
            if isinstance(exc, UnreadableFileError):
                raise
            raise UnreadableFileError(f"{path} is cut off or damaged ({exc}); copy it again") from exc


class LogReader:
    """Messages and attachments of an open log (see `opened_log`)."""

    def __init__(self, stream: IO[bytes], path: Path) -> None:
        from mcap.reader import make_reader

        self._reader: Any = make_reader(stream, validate_crcs=True)
        self._path = path

    def attachments(self) -> dict[str, bytes]:
        """Every file within the log by its name.

        Raises:
            UnreadableFileError: a name that is there twice, or a file that is not the one that was attached.
        """
        found: dict[str, bytes] = {}
        for one in self._reader.iter_attachments():
            if one.name in found:
                raise UnreadableFileError(f"{self._path} holds two files of the name {one.name[:80]!r}")
            found[one.name] = one.data
        if self._metadata(DIGESTS) != {
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
        wanted, counts = list(kinds), dict.fromkeys(kinds, 0)
        for schema, channel, message in self._reader.iter_messages(topics=wanted, log_time_order=False):
            kind = kinds[channel.topic]
            if schema is None or schema.name != kind:
                raise UnreadableFileError(f"{self._path}: {channel.topic} is not of type {kind}")
            counts[channel.topic] += 1
            yield channel.topic, store.deserialize_cdr(message.data, kind)
        stated = self._metadata(COUNTS)
        if any(stated.get(topic, "0") != str(n) for topic, n in counts.items()):
            raise UnreadableFileError(f"{self._path} lacks messages that were written; copy it again")

    def _metadata(self, name: str) -> dict[str, str]:
        found: dict[str, str] = {}
        for record in self._reader.iter_metadata():
            found |= record.metadata if record.name == name else {}
        return found


def _require_mcap() -> None:
    try:
        import mcap  # noqa: F401
    except ImportError as exc:
        raise MissingDependencyError(
            'session logs need the packages mcap and rosbags; install them with: pip install "dvf-ig[log]"'
        ) from exc
