"""A peer that sends wrong messages over loopback: what arrives, and how long a thread beside it waits."""

import select
import socket
import threading
import time
from dataclasses import dataclass

import numpy as np

from dvf_ig.live.igtl import WireError, encode
from dvf_ig.live.link import Inbox, listen
from dvf_ig.live.priority import SESSION, schedule_first

from .wrong_messages import damaged_messages, samples

LOOK_S, ENDED_WITHIN_S = 0.002, 0.001
REST_S = 0.3


@dataclass(slots=True)
class HostilePeer:
    """What happened.

    Attributes:
        sent: damaged messages, each followed by a good one; over so many `connections`, as a wrong header
            ends one.
        arrived, refused: messages taken from the inbox, and those of them that were refused.
        dropped: by a full inbox.
        longest_wait_s: between two looks of a thread that looks every 2 ms, as a session does.
    """

    sent: int = 0
    connections: int = 0
    arrived: int = 0
    refused: int = 0
    dropped: int = 0
    longest_wait_s: float = 0.0


def hostile_peer(count: int, seed: int) -> HostilePeer:
    """Send so many wrong messages, connecting anew where the connection was ended."""
    found, inbox, stop = HostilePeer(), Inbox(), threading.Event()
    good, connection = encode(samples()[0]), None
    with listen("127.0.0.1", 0, inbox) as server:
        looker = threading.Thread(target=_look, args=(inbox, found, stop), daemon=True)
        looker.start()
        for data in damaged_messages(count, np.random.default_rng(seed)):
            if connection is None:
                connection = socket.create_connection(("127.0.0.1", server.port), timeout=5.0)
                found.connections += 1
            found.sent += 1
            if not _sent(connection, data + good):
                connection.close()
                connection = None
        if connection is not None:
            connection.close()
        stop.wait(REST_S)
        stop.set()
        looker.join()
    found.dropped = inbox.dropped
    return found


def _sent(connection: socket.socket, data: bytes) -> bool:
    """Whether the connection has outlived it."""
    try:
        connection.sendall(data)
        return not select.select([connection], [], [], ENDED_WITHIN_S)[0]
    except OSError:
        return False


def _look(inbox: Inbox, found: HostilePeer, stop: threading.Event) -> None:
    schedule_first(SESSION)
    last_s = time.monotonic()
    while not stop.is_set():
        arrivals = inbox.take(LOOK_S)
        now_s = time.monotonic()
        found.longest_wait_s, last_s = max(found.longest_wait_s, now_s - last_s), now_s
        found.arrived += len(arrivals)
        found.refused += sum(isinstance(arrival.taken, WireError) for arrival in arrivals)
