"""Server of the page: three fixed addresses, only GET, only from this machine.

Nothing that a browser sends is used except which of the three it requests and its origin: a page of another
origin is refused (Host, Origin, Sec-Fetch-Site), whether or not it could read the answers. Requests are
served at REQUESTS_HZ in total, so that a flood takes little of the interpreter from the session. Threads
here have no lower priority than others: a thread suspended while it holds the interpreter suspends the
session.
"""

import socket
import threading
import time
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Protocol

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.report.viewer import live_page


class Feed(Protocol):
    """Source of the page's data."""

    def scene(self) -> tuple[bytes, bytes]:
        """Return scene.json in two parts."""

    def next_event(self) -> str | None:
        """Return what is new since the last call as JSON, or None."""


MOST_WATCHERS = 4
"""Largest number of watchers; one slot is reserved for a page of this server."""


@dataclass(slots=True, eq=False)
class Watcher:
    """Watcher that receives events until `gone` is set."""

    own_page: bool
    gone: threading.Event = field(default_factory=threading.Event)


class Watchers:
    """Registry that accepts and refuses watchers, from any thread."""

    def __init__(self) -> None:
        self._watching: list[Watcher] = []
        self._changed = threading.Lock()

    def __bool__(self) -> bool:
        return bool(self._watching)

    def begin(self, *, own_page: bool) -> Watcher | None:
        """Register a new watcher, or return None if no slot is free.

        Args:
            own_page: the request comes from a page of this server; the oldest other program is dropped for
                it.
        """
        with self._changed:
            others = [one for one in self._watching if not one.own_page]
            if len(others) >= MOST_WATCHERS - 1 and not own_page:
                return None
            if len(self._watching) >= MOST_WATCHERS:
                if not own_page or not others:
                    return None
                others[0].gone.set()
                self._watching.remove(others[0])
            watcher = Watcher(own_page)
            self._watching.append(watcher)
            return watcher

    def end(self, watcher: Watcher) -> None:
        """Remove a watcher; a second call has no effect."""
        with self._changed:
            if watcher in self._watching:
                self._watching.remove(watcher)


EVENTS_HZ = 30.0
SILENT_S = 1.0
"""Time without news after which a comment is sent, to detect whether the browser still listens."""
REQUEST_S, READ_S = 2.0, 5.0
"""Time after which a browser that neither requests nor reads is cut off."""
REQUESTS_HZ, MOST_AT_ONCE = 20.0, 10
"""Accepted connections, per second on average and at once; a page needs three."""
_HOSTS = ("127.0.0.1", "localhost")
_SAME_SITE = (None, "same-origin", "none")
"""Values that a browser sends for requests by its user or a page of this server; other programs send none."""


class _Handler(BaseHTTPRequestHandler):
    server: "_Server"
    protocol_version = "HTTP/1.0"
    timeout = READ_S

    def do_GET(self) -> None:
        """Serve one of the three addresses."""
        self.server.asked(self.connection)
        if not self._of_this_site():
            self.send_error(403)
        elif self.path == "/":
            self._send("text/html; charset=utf-8", self.server.page)
        elif self.path == "/scene.json":
            self._send("application/json", *self.server.feed.scene())
        elif self.path == "/events":
            self._send_events()
        else:
            self.send_error(404)

    def log_message(self, *_: object) -> None:
        """Suppress logging."""

    def _of_this_site(self) -> bool:
        """Return whether the user, a page of this server, or a program on this machine sends the request."""
        host = self.headers.get("Host", "")
        return (
            host.rpartition(":")[0] in _HOSTS
            and self.headers.get("Origin") in (None, f"http://{host}")
            and self.headers.get("Sec-Fetch-Site") in _SAME_SITE
        )

    def _begin(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()

    def _send(self, kind: str, *parts: bytes) -> None:
        self._begin(kind)
        for part in parts:
            self.wfile.write(part)

    def _send_events(self) -> None:
        own_page = self.headers.get("Sec-Fetch-Site") == "same-origin"
        watcher = self.server.watchers.begin(own_page=own_page)
        if watcher is None:
            self.send_error(503)
            return
        try:
            self._begin("text/event-stream")
            self._send_news(watcher)
        except OSError:
            return
        finally:
            self.server.watchers.end(watcher)

    def _send_news(self, watcher: Watcher) -> None:
        seen = self.server.newest
        while not self.server.stopped.is_set() and not watcher.gone.is_set():
            number, line = self.server.wait_newer(seen, SILENT_S)
            self.wfile.write(b": quiet\n\n" if number == seen else line)
            seen = number
            self.wfile.flush()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = 32

    def __init__(self, port: int, feed: Feed) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.feed, self.page = feed, live_page().encode()
        self.watchers = Watchers()
        self.stopped = threading.Event()
        self._changed = threading.Condition()
        self._number, self._line = 0, b""
        self._asking: dict[Any, float] = {}
        """Connections without a request yet, and their start."""
        self._allowed, self._allowed_s = float(MOST_AT_ONCE), time.monotonic()

    # ------------------------------------------------------------------ connections

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept a connection when its turn has come."""
        now_s = time.monotonic()
        earned = (now_s - self._allowed_s) * REQUESTS_HZ
        self._allowed, self._allowed_s = min(MOST_AT_ONCE, self._allowed + earned), now_s
        self._allowed -= 1.0
        if self._allowed < 0.0:
            self.stopped.wait(-self._allowed / REQUESTS_HZ)
        connection, address = super().get_request()
        self._asking[connection] = time.monotonic()
        return connection, address

    def asked(self, connection: socket.socket) -> None:
        """Note that a connection's request has been read."""
        self._asking.pop(connection, None)

    def shutdown_request(self, request: Any) -> None:
        self._asking.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Cut off connections that do not complete a request in time."""
        late_s = time.monotonic() - REQUEST_S
        for connection, since_s in list(self._asking.items()):
            if since_s < late_s and self._asking.pop(connection, None) is not None:
                try:
                    connection.shutdown(socket.SHUT_RDWR)
                except OSError:  # it has closed already
                    continue

    def handle_error(self, *_: object) -> None:
        """Ignore errors of a browser that has disconnected."""

    # ------------------------------------------------------------------ events

    @property
    def newest(self) -> int:
        """Number of the newest event."""
        with self._changed:
            return self._number

    def wait_newer(self, seen: int, wait_s: float) -> tuple[int, bytes]:
        """Return the newest event once it is newer, or after `wait_s`; a slow browser skips some."""
        with self._changed:
            self._changed.wait_for(lambda: self._number != seen or self.stopped.is_set(), wait_s)
            return self._number, self._line

    def publish(self) -> None:
        """Publish what is new as an event, if somebody watches."""
        event = self.feed.next_event() if self.watchers else None
        if event is not None:
            with self._changed:
                self._number, self._line = self._number + 1, f"data: {event}\n\n".encode()
                self._changed.notify_all()

    def wake(self) -> None:
        """Wake all waiting threads at the end."""
        self.stopped.set()
        with self._changed:
            self._changed.notify_all()


class PageServer:
    """Context manager that shows the session at http://127.0.0.1:port.

    Args:
        feed: feed of the session.
        port: 0 lets the system choose.
    Raises:
        InvalidInputError: the port is taken.
    """

    def __init__(self, feed: Feed, port: int) -> None:
        try:
            self._server = _Server(port, feed)
        except OSError as exc:
            raise InvalidInputError(
                f"cannot serve the page at port {port} ({exc.strerror or exc}); choose another --page"
            ) from exc
        self.port = int(self._server.server_address[1])
        self._threads = (
            threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True),
            threading.Thread(target=self._publish, name="dvf-ig page", daemon=True),
        )

    def __enter__(self) -> "PageServer":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.publish()
        self._server.stopped.wait(2.0 / EVENTS_HZ)  # the watchers get what came last
        self._server.wake()
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join()

    def _publish(self) -> None:
        while not self._server.stopped.wait(1.0 / EVENTS_HZ):
            self._server.publish()
