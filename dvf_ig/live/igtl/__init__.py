"""OpenIGTLink, versions 1 to 3: messages as values, a decoder that trusts nothing, an encoder."""

from .codec import Incoming as Incoming
from .codec import decode as decode
from .codec import encode as encode
from .message import Ignored as Ignored
from .message import Image as Image
from .message import Message as Message
from .message import Status as Status
from .message import StatusCode as StatusCode
from .message import Text as Text
from .message import TrackedTool as TrackedTool
from .message import TrackingData as TrackingData
from .message import Transform as Transform
from .message import WireError as WireError
from .message import WireProblem as WireProblem
