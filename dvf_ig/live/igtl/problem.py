"""Problems of OpenIGTLink messages, and the error that reports them."""

from enum import Enum

from dvf_ig.core.errors import InvalidInputError


class WireProblem(Enum):
    """Reason for refusing a message; the value is the sentence that a user reads."""

    VERSION = "the header's version is none of 1, 2 and 3"
    NAME = "type or device name is no text"
    TOO_LARGE = "the body is larger than a message of this type can be"
    TOO_SLOW = "the rest of the message did not come in time"
    CLOSED = "the peer closed the connection within a message"
    CHECKSUM = "the checksum does not belong to the body"
    SIZE = "the body's size does not fit what it states to hold"
    VALUE = "a field holds a value that the protocol does not know"
    NOT_FINITE = "a number is not finite"
    NOT_RIGID = "a matrix is not a rigid motion, or its translation is beyond a kilometre"

    @property
    def ends_connection(self) -> bool:
        """True if the start of the next message is lost."""
        return self in _FRAMING


_FRAMING = frozenset(
    {WireProblem.VERSION, WireProblem.NAME, WireProblem.TOO_LARGE, WireProblem.TOO_SLOW, WireProblem.CLOSED}
)


class WireError(InvalidInputError):
    """Refused message.

    Attributes:
        problem: the reason.
        kind, device, stamp_s: type, device name and time stamp of the message if its header was read.
    """

    def __init__(
        self, problem: WireProblem, kind: str = "", device: str = "", stamp_s: float | None = None
    ) -> None:
        self.problem, self.kind, self.device, self.stamp_s = problem, kind, device, stamp_s
        what = f"{kind} '{device}'" if kind else "an OpenIGTLink message"
        super().__init__(f"{what} is refused: {problem.value}")
