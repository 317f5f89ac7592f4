"""Splitting of a byte stream, cut in any pieces, into messages; no socket."""

from .codec import HEADER_BYTES, Header, decode_body, decode_header
from .message import Ignored, Message, WireError, WireProblem

Taken = Message | WireError


class Incoming:
    """Incremental decoder of a byte stream; it never holds more than one message and one piece."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._header: Header | None = None
        self._skip = 0

    @property
    def within_message(self) -> bool:
        """True if a message has begun and not ended."""
        return self._header is not None or self._skip > 0 or len(self._buffer) > 0

    def feed(self, data: bytes) -> list[Taken]:
        """Return the messages that these bytes complete; an error replaces a refused one.

        Raises:
            WireError: the start of the next message is lost.
        """
        messages: list[Taken] = []
        self._buffer += data
        while True:
            if self._skip:
                passed = min(self._skip, len(self._buffer))
                del self._buffer[:passed]
                self._skip -= passed
                if self._skip:
                    return messages
            if self._header is None:
                if len(self._buffer) < HEADER_BYTES:
                    return messages
                self._header = self._begin()
            if not self._header.is_read:
                messages.append(self._passed_over(self._header))
                continue
            if len(self._buffer) < self._header.body_bytes:
                return messages
            messages.append(self._taken(self._header))

    def close(self) -> None:
        """Handle the peer's closing of the connection.

        Raises:
            WireError: it was closed within a message.
        """
        if self.within_message:
            raise WireError(WireProblem.CLOSED)

    def _begin(self) -> Header:
        header = decode_header(self._buffer[:HEADER_BYTES])
        del self._buffer[:HEADER_BYTES]
        return header

    def _passed_over(self, header: Header) -> Message:
        self._header, self._skip = None, header.body_bytes
        return Message(header.device, header.stamp_s, Ignored(header.kind))

    def _taken(self, header: Header) -> Taken:
        body = bytes(memoryview(self._buffer)[: header.body_bytes])
        del self._buffer[: header.body_bytes]
        self._header = None
        try:
            return decode_body(header, body)
        except WireError as error:
            return error
