"""Waiting for what another thread or program does, as long as a busy machine may need."""

import time
from collections.abc import Callable

WITHIN_S = 30.0
"""Spent only by a test that fails."""


def until(condition: Callable[[], object], found: Callable[[], str] = lambda: "") -> None:
    """Come back as soon as it holds; where it does not within WITHIN_S, fail and say what was found."""
    end = time.monotonic() + WITHIN_S
    while not condition():
        assert time.monotonic() < end, f"it did not happen in time; {found()}"
        time.sleep(0.002)
