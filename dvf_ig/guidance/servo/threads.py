"""Threads that the machine schedules before all ordinary programs, where it allows that."""

import os
import threading
from collections.abc import Callable
from typing import Any

PRIORITY = 80


def real_time_thread(
    name: str, function: Callable[..., Any], *arguments: Any
) -> tuple[threading.Thread, bool]:
    """A running thread, and whether it has a real-time priority (Linux: root, or an rtprio limit)."""
    thread = threading.Thread(target=function, args=arguments, name=name, daemon=True)
    thread.start()
    try:
        os.sched_setscheduler(thread.native_id or 0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return thread, False
    return thread, True
