"""Web page on this machine that shows the running session."""

from .feed import PageFeed as PageFeed
from .server import PageServer as PageServer
