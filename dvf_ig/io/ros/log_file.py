"""MCAP files with ROS 2 messages and attachments: `ros2 bag`, Foxglove and PlotJuggler open them."""

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


class LogWriter:
    """Appends messages and attachments to an open MCAP file (see `written_log`)."""

    def __init__(self, stream: IO[bytes]) -> None:
        from mcap.writer import Writer

        self._writer = Writer(stream)
        self._writer.start(profile="ros2", library="dvf_ig")
        self._types: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def write(self, topic: str, kind: str, t_s: float, message: Message) -> None:
        """A message of type `kind` that belongs to `t_s`."""
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._type(kind))
        stamp = nanoseconds(t_s)
        data = bytes(typestore().serialize_cdr(message, kind))
        self._writer.add_message(self._channels[topic], stamp, data, stamp)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """A file within the log."""
        self._writer.add_attachment(0, 0, name, media_type, data)

    def finish(self) -> None:
        """Write the index; no message may follow."""
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

    with reading(path, WHAT), path.open("rb") as stream:
        if path.stat().st_size > limits.FILE_BYTES or stream.read(len(MARK)) != MARK:
            raise UnreadableFileError(f"{path} is not {WHAT}, or larger than {limits.FILE_BYTES:.3g} bytes")
        stream.seek(0)
        try:
            yield LogReader(stream, path)
        except (McapError, MemoryError, RuntimeError, LookupError, AttributeError, ArithmeticError) as exc:
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
            UnreadableFileError: a name that is there twice.
        """
        found: dict[str, bytes] = {}
        for one in self._reader.iter_attachments():
            if one.name in found:
                raise UnreadableFileError(f"{self._path} holds two files of the name {one.name[:80]!r}")
            found[one.name] = one.data
        return found

    def messages(self, kinds: Mapping[str, str]) -> Iterator[tuple[str, Message]]:
        """(topic, message) of the wanted topics, each in the order in which it was written.

        Args:
            kinds: of each topic, its type.
        Raises:
            UnreadableFileError: a topic is of another type.
        """
        store = typestore()
        wanted = list(kinds)
        for schema, channel, message in self._reader.iter_messages(topics=wanted, log_time_order=False):
            kind = kinds[channel.topic]
            if schema is None or schema.name != kind:
                raise UnreadableFileError(f"{self._path}: {channel.topic} is not of type {kind}")
            yield channel.topic, store.deserialize_cdr(message.data, kind)


def _require_mcap() -> None:
    try:
        import mcap  # noqa: F401
    except ImportError as exc:
        raise MissingDependencyError(
            'session logs need the packages mcap and rosbags; install them with: pip install "dvf-ig[log]"'
        ) from exc
