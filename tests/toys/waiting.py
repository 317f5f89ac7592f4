"""Waiting for what another thread or program does, as long as a busy machine may need."""

import signal
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
WITHIN_S = 30.0
"""Spent only by a test that fails."""


def until(condition: Callable[[], T], found: Callable[[], str] = lambda: "") -> T:
    """Its first true answer; where there is none within WITHIN_S, fail and say what was found."""
    end = time.monotonic() + WITHIN_S
    while not (answer := condition()):
        assert time.monotonic() < end, f"it did not happen in time; {found()}"
        time.sleep(0.002)
    return answer


def heed_interrupts() -> None:
    """Heed Ctrl-C in a new process, which a shell's background job and its children ignore."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
