"""The live page: what it serves, to whom, and what its events say."""

import http.client
import json
import socket
import threading
import time

import numpy as np
import pytest
from live_toy import LiveToy
from toy_session import CENTER
from waiting import WITHIN_S, until

from dvf_ig.core import InvalidInputError
from dvf_ig.live.page import PageFeed, PageServer
from dvf_ig.live.page.server import MOST_WATCHERS, Watchers


@pytest.fixture(scope="module")
def feed(watched: tuple[LiveToy, PageFeed]) -> PageFeed:
    """After a live session in which nothing went wrong."""
    return watched[1]


@pytest.fixture(scope="module")
def told(feed: PageFeed) -> dict[str, object]:
    """The first event, with all that had gathered."""
    event = feed.next_event()
    assert event is not None
    return json.loads(event)


def test_event_says_what_was_sent(feed, told):
    assert told["supervisor"] == "ok"
    assert told["status"] == "ok"
    assert abs(told["t_s"] - 14.5) < 0.05
    force = [told[f"force_tracker_{axis}_n"] for axis in "xyz"]
    assert np.linalg.norm(force) > 0.02
    tip = np.array([told[f"tip_mr_{axis}_mm"] for axis in "xyz"])
    assert np.linalg.norm(tip - CENTER) < 8.0
    assert len(told["r_peaks_s"]) in (16, 17, 18)
    assert told["marks"][0]["kind"] == "registration"
    assert len(told["ecg"]["t_s"]) == len(told["ecg"]["values"]) > 2000
    assert told["frame"]["mime"] == "image/jpeg"
    placed = np.array(told["frame"]["mr_from_pixel"])
    np.testing.assert_allclose(np.linalg.norm(placed[:, :2], axis=0), (4.0, 4.0), rtol=1e-3)
    assert feed.next_event() is None


def test_scene_knows_the_image_once_one_has_come(feed, told):
    scene = json.loads(b"".join(feed.scene()))
    assert scene["kind"] == "live"
    assert (scene["image"]["columns"], scene["image"]["rows"]) == (24, 24)


@pytest.fixture
def server(feed):
    with PageServer(feed, 0) as server:
        yield server


def answer(
    port: int, method: str, path: str, host: str | None = None, **headers: str
) -> tuple[int, str, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=WITHIN_S)
    try:
        connection.putrequest(method, path, skip_host=True)
        connection.putheader("Host", host or f"127.0.0.1:{port}")
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        got = connection.getresponse()
        return got.status, got.getheader("Content-Type") or "", got.read()
    finally:
        connection.close()


def test_three_addresses_and_nothing_else(server):
    status, kind, body = answer(server.port, "GET", "/")
    assert (status, kind) == (200, "text/html; charset=utf-8")
    assert b'id="dvf-scene"' in body
    status, kind, body = answer(server.port, "GET", "/scene.json")
    assert (status, kind) == (200, "application/json")
    assert json.loads(body)["schema"] == "dvf_ig.view/1"
    for path in ("/index.html", "/../etc/passwd", "/events/", "/?x"):
        assert answer(server.port, "GET", path)[0] == 404
    for method in ("POST", "PUT", "DELETE", "HEAD", "OPTIONS"):
        assert answer(server.port, method, "/")[0] == 501


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example:80"])
def test_other_names_for_this_machine_are_refused(server, host):
    assert answer(server.port, "GET", "/scene.json", host)[0] == 403


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Sec_Fetch_Site": "cross-site"}, 403),
        ({"Sec_Fetch_Site": "same-site"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Sec_Fetch_Site": "none"}, 200),
        ({"Sec_Fetch_Site": "same-origin"}, 200),
    ],
)
def test_pages_of_other_sites_are_refused(server, headers, status):
    for path in ("/", "/scene.json"):
        assert answer(server.port, "GET", path, **headers)[0] == status
    own = f"http://127.0.0.1:{server.port}"
    assert answer(server.port, "GET", "/", Origin=own)[0] == 200


def test_the_scene_is_made_once(feed, monkeypatch):
    """JSON of a whole heart would hold the interpreter; what a request makes is the image's size."""
    first, _ = feed.scene()
    monkeypatch.setattr("dvf_ig.live.page.feed.scene_payload", None)
    assert feed.scene()[0] is first


def test_a_page_of_this_server_always_finds_a_place():
    watchers = Watchers()
    others = [watchers.begin(own_page=False) for _ in range(MOST_WATCHERS)]
    assert [one is None for one in others] == [False] * (MOST_WATCHERS - 1) + [True]
    own = [watchers.begin(own_page=True) for _ in range(MOST_WATCHERS)]
    assert None not in own
    assert all(one.gone.is_set() for one in others if one is not None)
    assert watchers.begin(own_page=True) is None
    for one in own:
        watchers.end(one)
        watchers.end(one)
    assert not watchers
    assert watchers.begin(own_page=False) is not None


def test_connections_that_do_not_ask_are_cut_off_and_lock_nobody_out(server):
    """Each goes on byte by byte, which no timeout of a single read ends."""
    idle = [socket.create_connection(("127.0.0.1", server.port), timeout=WITHIN_S) for _ in range(15)]
    for one in idle:
        one.sendall(b"GET /events HTTP/1.0\r\n")
    assert answer(server.port, "GET", "/")[0] == 200
    until(lambda: not server._server._asking)
    for one in idle:
        assert one.recv(1) == b""
        one.close()


def test_a_flood_is_served_slowly(server):
    """Requests that a session would have to wait for are left waiting themselves."""
    begin_s, served = time.monotonic(), 0
    while time.monotonic() - begin_s < 1.0:
        assert answer(server.port, "GET", "/nothing")[0] == 404
        served += 1
    assert served <= 10 + 20 * (time.monotonic() - begin_s) + 2


def test_events_come_as_they_happen(server, feed):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=WITHIN_S)
    connection.request("GET", "/events")
    got = connection.getresponse()
    assert got.getheader("Content-Type") == "text/event-stream"
    feed._told_s = float("-inf")
    line = got.readline()
    assert line.startswith(b"data: {")
    assert json.loads(line[6:])["status"] == "ok"
    got.close()
    connection.close()
    assert threading.active_count() < 30


def test_port_that_is_taken_is_a_sentence(server, feed):
    with pytest.raises(InvalidInputError, match="--page"):
        PageServer(feed, server.port)
