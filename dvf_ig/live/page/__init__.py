"""A web page on this machine that shows the session as it runs."""

from .feed import PageFeed as PageFeed
from .server import PageServer as PageServer
