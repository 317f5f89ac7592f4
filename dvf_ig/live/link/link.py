"""Peers over time: a client that connects again and again, or a server that takes those who are allowed."""

import socket
import threading
from collections.abc import Callable, Sequence
from ipaddress import IPv4Address, IPv6Address, ip_address

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.live.igtl import Message, encode

from .inbox import Inbox
from .peer import Peer

RETRY_S = 0.2
CONNECT_WITHIN_S = 2.0
LAST_WITHIN_S = 0.1
MOST_PEERS = 8
LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 18944
"""Where PLUS listens, and 3D Slicer by default."""


class Link:
    """The peers of a session, however often they come and go; a context manager that ends with its threads.

    Made by `connect` or `listen`.
    """

    def __init__(self, inbox: Inbox | None, run: Callable[["Link"], None]) -> None:
        self.inbox = inbox
        self.port = 0
        """That a server listens at."""
        self.connections = self.turned_away = 0
        self.last_end: str | None = None
        """Why the last connection ended."""
        self.unreachable: str | None = None
        """Why a client could not connect when it last tried and failed."""
        self.farewell = b""
        """Whole messages for a peer that is cut off because of what it sent."""
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
        """Those who are connected."""
        with self._changed:
            for gone in [peer for peer in self._peers if not peer.connected]:
                self._peers.remove(gone)
                self._dropped += gone.dropped
                self.last_end = f"{gone.name}: {gone.ended or 'the peer closed the connection'}"
            return tuple(self._peers)

    @property
    def dropped(self) -> int:
        """Messages that were not sent to peers that did not read."""
        peers = self.peers
        return self._dropped + sum(peer.dropped for peer in peers)

    def add(self, connection: socket.socket, name: str) -> None:
        """A new peer."""
        peer = Peer(connection, name, self.inbox, lambda: self.farewell)
        self.connections += 1
        with self._changed:
            self._peers.append(peer)

    def send(self, messages: Sequence[Message]) -> None:
        """Offer messages to every peer; never waits."""
        if not messages:
            return
        data = b"".join(encode(message) for message in messages)
        for peer in self.peers:
            peer.offer(data)

    def send_last(self, messages: Sequence[Message]) -> None:
        """Send the session's last messages; waits LAST_WITHIN_S at most for a peer that does not read."""
        data = b"".join(encode(message) for message in messages)
        for peer in self.peers:
            peer.offer_last(data, LAST_WITHIN_S)


def connect(host: str, port: int, inbox: Inbox | None) -> Link:
    """A client of one server, connected again whenever the connection ends."""

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
    """A server for the peers that are allowed, up to MOST_PEERS of them.

    Args:
        host: address to listen at.
        port: 0 lets the system choose; `Link.port` says which.
        allowed: addresses; others are turned away before a byte of theirs is read.
    Raises:
        InvalidInputError: the address cannot be listened at, or an allowed one is none.
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
    """Whether an address or name is this machine's own and reached by no other."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _addresses(names: Sequence[str]) -> set[IPv4Address | IPv6Address]:
    """Raises InvalidInputError where one is no address."""
    try:
        return {ip_address(name) for name in names}
    except ValueError as exc:
        raise InvalidInputError(f"{exc}; give addresses such as 192.0.2.7 (--allow)") from exc
