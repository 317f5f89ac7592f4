"""Connections: half messages, peers that do not read, that come back, that nobody allowed."""

import socket
import threading
import time

import numpy as np
import pytest
from waiting import WITHIN_S, until

from dvf_ig.core import InvalidInputError
from dvf_ig.intake.live import EcgFieldConfig, LiveConfig
from dvf_ig.live.igtl import Image, Message, Transform, WireError, WireProblem, encode
from dvf_ig.live.link import MOST, Arrival, Inbox, Peer, connect, listen
from dvf_ig.live.serve import open_link

POSE = Message("ProbeToTracker", 1.0, Transform(np.eye(4)))
IMAGE = Message("Image", 1.0, Image(np.zeros((1, 600, 800), np.uint8), np.eye(4)))
ECG = EcgFieldConfig(rate_hz=500.0)


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair(socket.AF_UNIX)
    theirs.settimeout(WITHIN_S)
    yield ours, theirs
    theirs.close()


@pytest.fixture
def no_delay(monkeypatch):
    """A socket pair has no TCP options."""
    monkeypatch.setattr("dvf_ig.live.link.socket.TCP_NODELAY", socket.SO_KEEPALIVE)
    monkeypatch.setattr("dvf_ig.live.link.socket.IPPROTO_TCP", socket.SOL_SOCKET)


def test_messages_arrive_and_refused_ones_are_counted(pair, no_delay):
    inbox = Inbox()
    peer = Peer(pair[0], "x", inbox)
    bad = bytearray(encode(POSE))
    bad[-1] ^= 1
    pair[1].sendall(encode(POSE) + bytes(bad) + encode(POSE))
    until(lambda: peer.received == 3)
    kinds = [type(arrival.taken) for arrival in inbox.take(1.0)]
    assert kinds == [Message, WireError, Message]
    assert peer.refused == 1
    peer.close()
    assert peer.ended is None


def test_half_a_message_ends_the_connection_in_time(pair, no_delay):
    peer = Peer(pair[0], "x", Inbox(), message_s=0.05)
    pair[1].sendall(encode(POSE)[:70])
    until(lambda: not peer.connected)
    assert isinstance(peer.ended, WireError)
    assert peer.ended.problem is WireProblem.TOO_SLOW


def test_silence_between_messages_ends_nothing(pair, no_delay):
    peer = Peer(pair[0], "x", Inbox(), message_s=0.02)
    pair[1].sendall(encode(POSE))
    until(lambda: peer.received == 1)
    time.sleep(0.1)
    assert peer.connected
    peer.close()


def test_peer_that_closes_within_a_message_is_told(pair, no_delay):
    peer = Peer(pair[0], "x", Inbox())
    pair[1].sendall(encode(POSE)[:70])
    pair[1].close()
    until(lambda: not peer.connected)
    assert isinstance(peer.ended, WireError)
    assert peer.ended.problem is WireProblem.CLOSED


def test_garbage_ends_the_connection(pair, no_delay):
    peer = Peer(pair[0], "x", Inbox())
    pair[1].sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nAccept: text/html, image/png\r\n\r\n")
    until(lambda: not peer.connected)
    assert isinstance(peer.ended, WireError)
    assert peer.ended.problem is WireProblem.VERSION


def test_peer_that_does_not_read_stops_nobody(pair, no_delay):
    """Offers return at once; what is sent in the end is whole messages."""
    peer, data = Peer(pair[0], "x", None), encode(IMAGE)
    for _ in range(50):
        peer.offer(data)
    assert peer.dropped > 40
    got = bytearray()
    while len(got) < len(data):
        got += pair[1].recv(1 << 20)
        peer.offer(encode(POSE))
    assert bytes(got[: len(data)]) == data
    peer.close()


def test_full_inbox_refuses_and_counts():
    inbox = Inbox()
    for _ in range(MOST + 5):
        inbox.put(Arrival(0.0, "x", POSE))
    assert inbox.dropped == 5
    assert len(inbox.take(0.0)) == MOST
    for _ in range(400):
        inbox.put(Arrival(0.0, "x", IMAGE))
    assert inbox.dropped > 100
    assert inbox.take(0.0)
    assert inbox.take(0.0) == []


def test_client_connects_again_when_its_server_comes_back():
    inbox = Inbox()
    with listen("127.0.0.1", 0, None) as first:
        port = first.port
        client = connect("127.0.0.1", port, inbox)
        with client:
            until(lambda: len(first.peers) == 1)
            first.send((POSE,))
            until(lambda: inbox.take(0.1))
            first.__exit__()
            until(lambda: not client.peers)
            assert "closed" in (client.last_end or "")
            with listen("127.0.0.1", port, None) as second:
                until(lambda: len(second.peers) == 1)
                second.send((POSE,))
                until(lambda: inbox.take(0.1))
            assert client.connections == 2


def test_peers_that_nobody_allowed_are_turned_away():
    inbox = Inbox()
    with listen("127.0.0.1", 0, inbox, allowed=("10.1.2.3",)) as server:
        with socket.create_connection(("127.0.0.1", server.port)) as stranger:
            stranger.settimeout(WITHIN_S)
            assert stranger.recv(1) == b""
        assert server.turned_away == 1
        assert not server.peers


@pytest.mark.parametrize("role", ["client", "server"])
def test_other_machines_need_to_be_allowed(role):
    with pytest.raises(InvalidInputError, match="--allow"):
        open_link(LiveConfig(host="192.0.2.7", role=role, ecg=ECG), Inbox())
    if role == "client":
        open_link(LiveConfig(host="192.0.2.7", allow=("192.0.2.7",), ecg=ECG), Inbox())


def test_port_that_is_taken_is_a_sentence():
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(InvalidInputError, match="--port"):
        listen("127.0.0.1", taken.getsockname()[1], None)


def test_a_peer_that_is_cut_off_is_told(pair, no_delay):
    peer = Peer(pair[0], "x", Inbox(), lambda: encode(POSE))
    pair[1].sendall(bytes(200))
    until(lambda: not peer.connected)
    assert pair[1].recv(1 << 16) == encode(POSE)
    assert pair[1].recv(1) == b""


def test_the_last_message_comes_after_the_rest_of_those_before(pair, no_delay):
    """A peer that reads late gets all of it; one that does not read keeps nobody for longer than was said."""
    peer, data = Peer(pair[0], "x", None), encode(IMAGE)
    peer.offer(data)
    got = bytearray()

    def read() -> None:
        while len(got) < len(data) + len(encode(POSE)):
            got.extend(pair[1].recv(1 << 16))

    reader = threading.Thread(target=read)
    reader.start()
    peer.offer_last(encode(POSE), WITHIN_S)
    reader.join()
    assert bytes(got) == data + encode(POSE)
    for _ in range(20):
        peer.offer(data)
    peer.offer_last(encode(POSE), 0.05)
    peer.close()
    peer.offer_last(encode(POSE), 0.05)
