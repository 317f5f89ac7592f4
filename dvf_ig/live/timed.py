"""Event of a session with its arrival."""

from typing import NamedTuple

from dvf_ig.session import Event


class LiveEvent(NamedTuple):
    """Event with the arrival of the message that completed it, by this machine's monotonic clock."""

    arrived_s: float
    event: Event
