"""Threads that must answer in milliseconds are scheduled before other work, where the machine allows it."""

import os
import threading

SESSION, RECEIVING = 70, 60
"""Below the servo's (`dvf_ig.guidance.servo.threads`); they sleep whenever nothing has arrived."""


def schedule_first(priority: int) -> bool:
    """Give the calling thread a real-time priority (Linux: root, or an rtprio limit); whether it has one."""
    if not hasattr(os, "sched_setscheduler"):
        return False
    try:
        os.sched_setscheduler(threading.get_native_id(), os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True
