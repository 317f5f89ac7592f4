"""Connections to PLUS and 3D Slicer: bytes in and out, bounded in memory and in time."""

import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import NamedTuple

from dvf_ig.core.errors import InvalidInputError

from .igtl import Image, Incoming, Message, WireError, WireProblem, encode
from .igtl.codec import Taken
from .priority import RECEIVING, schedule_first

MOST = 4096
"""Largest number of messages and bytes: ten seconds of a tracker at 100 Hz with three tools, or forty of two
minutes' images."""
MOST_BYTES = 128 << 20


class Arrival(NamedTuple):
    """Message, or why it was refused, with the time of its last byte and its sender."""

    arrived_s: float
    peer: str
    taken: Taken


class Inbox:
    """Queue that receiving threads fill and the session's thread empties."""

    def __init__(self) -> None:
        self._waiting: deque[Arrival] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self.dropped = 0
        """Number of arrivals refused because the queue was full."""

    def put(self, arrival: Arrival) -> None:
        """Add an arrival without waiting."""
        size = _bytes_of(arrival)
        with self._changed:
            if len(self._waiting) >= MOST or self._bytes + size > MOST_BYTES:
                self.dropped += 1
                return
            self._waiting.append(arrival)
            self._bytes += size
            self._changed.notify()

    def take(self, wait_s: float, most: int = MOST) -> list[Arrival]:
        """Remove up to `most` arrivals, waiting at most `wait_s` for the first."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(wait_s)
            arrivals = [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]
            self._bytes -= sum(map(_bytes_of, arrivals))
        return arrivals


def _bytes_of(arrival: Arrival) -> int:
    message = arrival.taken
    if isinstance(message, Message) and isinstance(message.content, Image):
        return int(message.content.pixels.nbytes)
    return 256


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


RETRY_S = 0.2
CONNECT_WITHIN_S = 2.0
LAST_WITHIN_S = 0.1
MOST_PEERS = 8
LOOPBACK = "127.0.0.1"


class Link:
    """Peers of a session, which may reconnect at any time; a context manager that ends its threads.

    Made by `connect` or `listen`.
    """

    def __init__(self, inbox: Inbox | None, run: Callable[["Link"], None]) -> None:
        self.inbox = inbox
        self.port = 0
        """Port at which a server listens."""
        self.connections = self.turned_away = 0
        self.last_end: str | None = None
        """Reason for which the last connection ended."""
        self.unreachable: str | None = None
        """Reason for a client's last failure to connect."""
        self.farewell = b""
        """Whole messages for a peer that is cut off because of invalid bytes."""
        self.stop = threading.Event()
        self._peers: list[Peer] = []
        self._changed = threading.Lock()
        self._dropped = 0
        self._thread = threading.Thread(target=run, args=(self,), name="dvf-ig link", daemon=True)

    def __enter__(self) -> "Link":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        self._thread.join()
        for peer in self.peers:
            peer.close()

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Connected peers."""
        with self._changed:
            for gone in [peer for peer in self._peers if not peer.connected]:
                self._peers.remove(gone)
                self._dropped += gone.dropped
                self.last_end = f"{gone.name}: {gone.ended or 'the peer closed the connection'}"
            return tuple(self._peers)

    @property
    def dropped(self) -> int:
        """Number of messages not sent because peers did not read."""
        peers = self.peers
        return self._dropped + sum(peer.dropped for peer in peers)

    def add(self, connection: socket.socket, name: str) -> None:
        """A new peer."""
        peer = Peer(connection, name, self.inbox, lambda: self.farewell)
        self.connections += 1
        with self._changed:
            self._peers.append(peer)

    def send(self, messages: Sequence[Message]) -> None:
        """Offer messages to every peer without waiting."""
        if not messages:
            return
        data = b"".join(encode(message) for message in messages)
        for peer in self.peers:
            peer.offer(data)

    def send_last(self, messages: Sequence[Message]) -> None:
        """Send the session's last messages, waiting at most LAST_WITHIN_S for a peer that does not read."""
        data = b"".join(encode(message) for message in messages)
        for peer in self.peers:
            peer.offer_last(data, LAST_WITHIN_S)


def connect(host: str, port: int, inbox: Inbox | None) -> Link:
    """Connect to one server as a client, again whenever the connection ends."""

    def run(link: Link) -> None:
        while not link.stop.is_set():
            if not link.peers:
                try:
                    connection = socket.create_connection((host, port), timeout=CONNECT_WITHIN_S)
                except OSError as error:
                    link.unreachable = f"{host}:{port}: {error.strerror or error}"
                else:
                    link.add(connection, f"{host}:{port}")
            link.stop.wait(RETRY_S)

    return Link(inbox, run)


def listen(host: str, port: int, inbox: Inbox | None, allowed: Sequence[str] = (LOOPBACK,)) -> Link:
    """Serve the allowed peers, up to MOST_PEERS of them.

    Args:
        host: address to listen at.
        port: 0 lets the system choose; `Link.port` holds it.
        allowed: addresses; others are refused before any of their bytes is read.
    Raises:
        InvalidInputError: the address is unusable, or an allowed one is not an address.
    """
    welcome = _addresses(allowed)
    try:
        server = socket.create_server((host, port))
    except OSError as exc:
        raise InvalidInputError(
            f"cannot listen at {host}:{port} ({exc.strerror or exc}); choose another --port, or end the "
            "program that uses it"
        ) from exc
    server.settimeout(0.1)

    def run(link: Link) -> None:
        with server:
            while not link.stop.is_set():
                try:
                    connection, address = server.accept()
                except TimeoutError:
                    continue
                if ip_address(address[0]) in welcome and len(link.peers) < MOST_PEERS:
                    link.add(connection, f"{address[0]}:{address[1]}")
                else:
                    link.turned_away += 1
                    connection.close()

    link = Link(inbox, run)
    link.port = server.getsockname()[1]
    return link


def is_loopback(host: str) -> bool:
    """Return whether an address or name can be reached only from this machine."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _addresses(names: Sequence[str]) -> set[IPv4Address | IPv6Address]:
    """Parse addresses, or raise InvalidInputError if one is invalid."""
    try:
        return {ip_address(name) for name in names}
    except ValueError as exc:
        raise InvalidInputError(f"{exc}; give addresses such as 192.0.2.7 (--allow)") from exc
