"""Programs that send the tool's poses: two at once are found; one that takes over from another is not."""

from dataclasses import dataclass, field

TOGETHER_S = 1.0
"""A program that has sent nothing for so long has ended."""


@dataclass(slots=True)
class _Sender:
    """One that sends without a break since `from_s`, last at `last_s`."""

    from_s: float
    last_s: float


@dataclass(slots=True)
class ToolSenders:
    """Peers that send the tool; times of arrival."""

    _senders: dict[str, _Sender] = field(default_factory=dict, init=False)
    _problem: str | None = field(default=None, init=False)
    _problem_s: float = field(default=0.0, init=False)

    def alone(self, peer: str, arrived_s: float) -> bool:
        """Take a pose; whether no other peer has sent one since this peer began."""
        last_s = arrived_s - TOGETHER_S
        self._senders = {name: one for name, one in self._senders.items() if one.last_s >= last_s}
        own = self._senders.setdefault(peer, _Sender(arrived_s, arrived_s))
        own.last_s = max(own.last_s, arrived_s)
        for name, other in self._senders.items():
            if name != peer and other.last_s > own.from_s:
                first, second = sorted((peer, name))
                self._problem_s = arrived_s
                self._problem = (
                    f"{first} and {second} both send the tool, which is taken as lost; end one of them"
                )
                return False
        return True

    def problem(self, now_s: float) -> str | None:
        """What is wrong with them now, as a user reads it."""
        return self._problem if now_s - self._problem_s < TOGETHER_S else None
