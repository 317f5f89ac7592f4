"""Messages of a live session: in the terminal, and with times in a file that a thread of its own writes."""

import logging
import logging.handlers
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import typer

LOG = logging.getLogger("dvf_ig.serve")
LogLevel = Literal["debug", "info", "warning"]
"""Levels of messages, the least severe first."""


class _Terminal(logging.Handler):
    """Prints messages on stderr; warnings are printed as notes already (`command`)."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno < logging.WARNING:
            typer.echo(record.getMessage(), err=True)


@contextmanager
def logged(level: LogLevel, file: Path | None) -> Iterator[None]:
    """Show messages from `level` on, and append them to a file if one is given.

    Raises:
        OutputError: the file cannot be written.
    """
    from dvf_ig.core import OutputError

    logger = logging.getLogger("dvf_ig")
    before = logger.level
    handlers: list[logging.Handler] = [_Terminal()]
    listener = None
    if file is not None:
        try:
            writer = logging.FileHandler(file, encoding="utf-8", errors="backslashreplace")
        except OSError as exc:
            raise OutputError(f"cannot write {file}: {exc.strerror or exc}") from exc
        writer.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        waiting: queue.SimpleQueue[logging.LogRecord] = queue.SimpleQueue()
        listener = logging.handlers.QueueListener(waiting, writer)
        listener.start()
        handlers.append(logging.handlers.QueueHandler(waiting))
    logger.setLevel(level.upper())
    for handler in handlers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for handler in handlers:
            logger.removeHandler(handler)
        logger.setLevel(before)
        if listener is not None:
            listener.stop()
            writer.close()
