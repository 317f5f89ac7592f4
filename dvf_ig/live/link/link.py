"""Peers over time: a client that reconnects, or a server that accepts allowed peers."""

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
"""Default port of PLUS and 3D Slicer."""


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
