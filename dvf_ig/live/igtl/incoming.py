"""A stream of bytes taken apart into messages, however it is cut into pieces; no socket."""

from .codec import decode_body
from .header import HEADER_BYTES, Header, decode_header
from .message import Ignored, Message
from .problem import WireError, WireProblem

Taken = Message | WireError


class Incoming:
    """Takes bytes as they come. What it holds never exceeds one message that is read and one piece."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._header: Header | None = None
        self._skip = 0

    @property
    def within_message(self) -> bool:
        """Whether a message has begun and not ended."""
        return self._header is not None or self._skip > 0 or len(self._buffer) > 0

    def feed(self, data: bytes) -> list[Taken]:
        """Messages that these bytes complete; an error in place of one that is refused.

        Raises:
            WireError: where the next message begins is lost.
        """
        found: list[Taken] = []
        self._buffer += data
        while True:
            if self._skip:
                passed = min(self._skip, len(self._buffer))
                del self._buffer[:passed]
                self._skip -= passed
                if self._skip:
                    return found
            if self._header is None:
                if len(self._buffer) < HEADER_BYTES:
                    return found
                self._header = self._begin()
            if not self._header.is_read:
                found.append(self._passed_over(self._header))
                continue
            if len(self._buffer) < self._header.body_bytes:
                return found
            found.append(self._taken(self._header))

    def close(self) -> None:
        """The peer has closed the connection.

        Raises:
            WireError: within a message.
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
