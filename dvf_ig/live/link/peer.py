"""Connected peer: a thread that receives, and sending that never waits."""

import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from dvf_ig.live.igtl import Incoming, WireError, WireProblem
from dvf_ig.live.priority import RECEIVING, schedule_first

from .inbox import Arrival, Inbox

PIECE_BYTES = 1 << 18
MESSAGE_S = 0.5
"""Time within which a message must end before the connection is closed: an image takes some 10 ms."""
LAST_LOOK_S = 0.01
READ_WITHIN_S = 0.1
"""Time for a peer to read the last messages and to close its side before the connection is closed."""
LOOK_EVERY_S = 0.1
"""Interval at which a thread that waits for bytes checks whether it must end."""


class Peer:
    """Connection that lasts until the peer closes it, breaks the protocol, or `close`.

    Args:
        connection: connected; the peer owns it.
        name: name of the peer, for messages.
        inbox: queue for arrivals; None discards them, for a peer that only receives.
        farewell: returns whole messages for a peer whose connection is ended here.
        clock: seconds, monotonic.
        message_s: time for a message that has begun.
    """

    def __init__(
        self,
        connection: socket.socket,
        name: str,
        inbox: Inbox | None,
        farewell: Callable[[], bytes] = bytes,
        clock: Callable[[], float] = time.monotonic,
        message_s: float = MESSAGE_S,
    ) -> None:
        self.name = name
        self.ended: WireError | OSError | None = None
        """Reason for which the connection ended, unless it was closed between two messages."""
        self.dropped = 0
        """Number of messages not sent because the peer did not read earlier ones."""
        self.received = self.refused = 0
        self._connection, self._inbox, self._clock, self._message_s = connection, inbox, clock, message_s
        self._farewell = farewell
        self._unsent = b""
        self._stop = threading.Event()
        self._sending = threading.Lock()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._thread = threading.Thread(target=self._receive, name=f"dvf-ig peer {name}", daemon=True)
        self._thread.start()

    @property
    def connected(self) -> bool:
        return self._thread.is_alive()

    def close(self) -> None:
        """End the connection; a second call has no effect."""
        self._stop.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def offer(self, data: bytes) -> None:
        """Send whole messages if the peer takes them now; else drop and count them."""
        with self._sending:
            if not self._flushed():
                self.dropped += 1
                return
            self._unsent = data
            self._flushed()

    def offer_last(self, data: bytes, within_s: float) -> None:
        """Send whole messages after the rest of earlier ones, as far as the peer reads them in time."""
        end_s = self._clock() + within_s
        poll = select.poll()
        with self._sending:
            if not self.connected:
                return
            poll.register(self._connection, select.POLLOUT)
            self._unsent += data
            while not self._flushed() and not self._stop.is_set() and self._clock() < end_s:
                poll.poll(1e3 * LAST_LOOK_S)

    def _flushed(self) -> bool:
        """Send the rest of earlier offers; return whether nothing is left."""
        while self._unsent:
            try:
                sent = self._connection.send(self._unsent)
            except BlockingIOError:
                return False
            except OSError as error:
                if not self._stop.is_set():
                    self.ended = self.ended or error
                self._stop.set()
                return False
            self._unsent = self._unsent[sent:]
        return True

    def _receive(self) -> None:
        schedule_first(RECEIVING)
        incoming = Incoming()
        try:
            self._receive_into(incoming)
        except (WireError, OSError) as error:
            if not self._stop.is_set():
                self.ended = error
                self.offer_last(self._farewell(), LOOK_EVERY_S)
        finally:
            self._stop.set()
            self._let_read()
            with self._sending:
                self._connection.close()

    def _let_read(self) -> None:
        """Let the peer read what was sent: closing over bytes not yet received resets a connection."""
        poll, end_s = select.poll(), self._clock() + READ_WITHIN_S
        poll.register(self._connection, select.POLLIN)
        with suppress(OSError):
            with self._sending:
                self._connection.shutdown(socket.SHUT_WR)
            while (left_s := end_s - self._clock()) > 0.0 and poll.poll(1e3 * left_s):
                if not self._connection.recv(PIECE_BYTES):
                    return

    def _receive_into(self, incoming: Incoming) -> None:
        begun_s: float | None = None
        poll = select.poll()
        poll.register(self._connection, select.POLLIN)
        while not self._stop.is_set():
            left_s = LOOK_EVERY_S if begun_s is None else begun_s + self._message_s - self._clock()
            if left_s <= 0.0:
                raise WireError(WireProblem.TOO_SLOW)
            if not poll.poll(1e3 * min(left_s, LOOK_EVERY_S)):
                continue
            data = self._connection.recv(PIECE_BYTES)
            arrived_s = self._clock()
            if not data:
                incoming.close()
                return
            messages = incoming.feed(data)
            for message in messages:
                self.received += 1
                self.refused += isinstance(message, WireError)
                if self._inbox is not None:
                    self._inbox.put(Arrival(arrived_s, self.name, message))
            if not incoming.within_message:
                begun_s = None
            elif messages or begun_s is None:
                begun_s = arrived_s
