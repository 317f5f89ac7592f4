"""The stderr of a live session, written by a thread of its own: nobody waits for a terminal."""

import io
import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

MOST_CHARACTERS = 1 << 18
"""Text that waits for the terminal; what comes beyond is left out."""
FLUSH_WITHIN_S = 1.0
"""At the end, what waits is written as far as it is taken within this time."""
PIECE_BYTES = 512
"""Written at once: less than any pipe or terminal takes that says it is ready (POSIX: PIPE_BUF)."""
LOOK_MS = 50


class QueuedStream(io.TextIOBase):
    """Takes text at once and hands it to a stream in a thread.

    Args:
        stream: to write to.
    """

    encoding = "utf-8"
    errors = "replace"

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._waiting: deque[str] = deque()
        self._size = 0
        self._changed = threading.Condition()
        self._ending = False
        self._end_s = float("inf")
        stream.flush()
        self._thread = threading.Thread(target=self._write_all, name="dvf-ig stderr", daemon=True)
        self._thread.start()

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._stream.isatty()

    def write(self, text: str) -> int:
        """Never waits."""
        if not isinstance(text, str):
            raise TypeError(f"text is needed, not {type(text).__name__}")
        with self._changed:
            if self._size + len(text) <= MOST_CHARACTERS:
                self._waiting.append(text)
                self._size += len(text)
                self._changed.notify()
        return len(text)

    def finish(self) -> None:
        """Write what waits, within FLUSH_WITHIN_S."""
        with self._changed:
            self._ending, self._end_s = True, time.monotonic() + FLUSH_WITHIN_S
            self._changed.notify()
        self._thread.join(FLUSH_WITHIN_S + 2e-3 * LOOK_MS)

    def _write_all(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._waiting or self._ending)
                    if not self._waiting:
                        return
                    text = self._waiting.popleft()
                    self._size -= len(text)
                if not self._written(text):
                    return
        except (OSError, ValueError):  # the terminal, or the pipe's reader, has gone: nobody reads it
            return

    def _written(self, text: str) -> bool:
        """Whether all was taken, before the end."""
        try:
            target = self._stream.fileno()
        except (OSError, ValueError):
            self._stream.write(text)
            self._stream.flush()
            return True
        left = text.encode(self._stream.encoding or "utf-8", "replace")
        ready = select.poll()
        ready.register(target, select.POLLOUT)
        while left:
            if time.monotonic() > self._end_s:
                return False
            if ready.poll(LOOK_MS):
                left = left[os.write(target, left[:PIECE_BYTES]) :]
        return True


@contextmanager
def queued_stderr() -> Iterator[None]:
    """Whatever is written to stderr meanwhile, by any thread, waits for nobody who reads it."""
    before = sys.stderr
    queued = QueuedStream(before)
    sys.stderr = queued
    try:
        yield
    finally:
        sys.stderr = before
        queued.finish()
