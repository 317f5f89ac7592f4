"""An event of a session, and when it came."""

from typing import NamedTuple

from dvf_ig.session import Event


class LiveEvent(NamedTuple):
    """An event, and when the message that completed it came, by this machine's monotonic clock."""

    arrived_s: float
    event: Event
