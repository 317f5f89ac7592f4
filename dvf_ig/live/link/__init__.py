"""Connections to PLUS and 3D Slicer: bytes in and out, bounded in memory and in time."""

from .inbox import Arrival as Arrival
from .inbox import Inbox as Inbox
from .link import Link as Link
from .link import connect as connect
from .link import listen as listen
