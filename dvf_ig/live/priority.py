"""Threads that must answer in milliseconds are scheduled before other work, where the machine allows it."""

import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

SESSION, RECEIVING, RECORDING = 70, 60, 50
"""Below the servo's (`dvf_ig.guidance.servo.servo`); they sleep whenever nothing has arrived. A record
needs little time, but while it holds the interpreter the session waits: other work must not put it off."""

SWITCH_S = 0.0005
"""Python's own 5 ms are two poses of a tracker where two threads compute beside."""


def schedule_first(priority: int) -> bool:
    """Give the calling thread a real-time priority (Linux: root, or an rtprio limit); whether it has one."""
    if not hasattr(os, "sched_setscheduler"):
        return False
    try:
        os.sched_setscheduler(threading.get_native_id(), os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


@contextmanager
def answering_soon() -> Iterator[None]:
    """A thread gets the interpreter within SWITCH_S, and what exists already is not searched for garbage.

    A search through all that libraries hold stops every thread for 70 ms and more; what is new is searched.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)
