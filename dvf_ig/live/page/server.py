"""The page's server: three fixed addresses, GET alone, this machine alone.

Nothing that a browser sends is used beyond which of the three it wants; a page of another origin can neither
read the answers nor, by a name of its own for this machine, pretend to be this one (the Host is checked).
"""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.report.viewer import live_page

from .feed import PageFeed

EVENTS_HZ = 30.0
MOST_WATCHERS = 4
SILENT_S = 1.0
"""After so long without news a comment is sent, which tells whether anybody still listens."""
REQUEST_S = 5.0
"""A browser that takes longer to ask, or to read, is cut off."""
_HOSTS = ("127.0.0.1", "localhost")


class _Handler(BaseHTTPRequestHandler):
    server: "_Server"
    protocol_version = "HTTP/1.0"
    timeout = REQUEST_S

    def do_GET(self) -> None:
        """One of the three."""
        if self.headers.get("Host", "").rpartition(":")[0] not in _HOSTS:
            self.send_error(403)
        elif self.path == "/":
            self._send(live_page(), "text/html; charset=utf-8")
        elif self.path == "/scene.json":
            self._send(self.server.feed.scene(), "application/json")
        elif self.path == "/events":
            self._send_events()
        else:
            self.send_error(404)

    def log_message(self, *_: object) -> None:
        """Nothing is logged."""

    def _begin(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()

    def _send(self, text: str, kind: str) -> None:
        self._begin(kind)
        self.wfile.write(text.encode())

    def _send_events(self) -> None:
        if not self.server.begin_watching():
            self.send_error(503)
            return
        try:
            self._begin("text/event-stream")
            seen = self.server.newest
            while not self.server.stopped.is_set():
                number, line = self.server.wait_newer(seen, SILENT_S)
                self.wfile.write(b": quiet\n\n" if number == seen else f"data: {line}\n\n".encode())
                seen = number
                self.wfile.flush()
        except OSError:
            return
        finally:
            self.server.end_watching()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, port: int, feed: PageFeed) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.feed = feed
        self._watchers = 0
        self.stopped = threading.Event()
        self._changed = threading.Condition()
        self._number, self._line = 0, ""

    def handle_error(self, *_: object) -> None:
        """A browser that went away is no error."""

    def begin_watching(self) -> bool:
        """Whether there is room for one more."""
        with self._changed:
            room = self._watchers < MOST_WATCHERS
            self._watchers += room
            return room

    def end_watching(self) -> None:
        with self._changed:
            self._watchers -= 1

    @property
    def newest(self) -> int:
        """Number of the newest event."""
        with self._changed:
            return self._number

    def wait_newer(self, seen: int, wait_s: float) -> tuple[int, str]:
        """The newest event, once it is newer, or after `wait_s`; a slow browser skips some."""
        with self._changed:
            self._changed.wait_for(lambda: self._number != seen or self.stopped.is_set(), wait_s)
            return self._number, self._line

    def publish(self) -> None:
        """Make an event of what is new, if somebody looks."""
        line = self.feed.next_event() if self._watchers else None
        if line is not None:
            with self._changed:
                self._number, self._line = self._number + 1, line
                self._changed.notify_all()

    def wake(self) -> None:
        """Let everybody see that it is over."""
        self.stopped.set()
        with self._changed:
            self._changed.notify_all()


class PageServer:
    """A context manager: while it lasts, http://127.0.0.1:port shows the session.

    Args:
        feed: of the session.
        port: 0 lets the system choose.
    Raises:
        InvalidInputError: the port is taken.
    """

    def __init__(self, feed: PageFeed, port: int) -> None:
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
        self._server.wake()
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join()

    def _publish(self) -> None:
        while not self._server.stopped.wait(1.0 / EVENTS_HZ):
            self._server.publish()
