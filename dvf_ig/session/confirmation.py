"""How long a pose may be used that no heart beat has confirmed (docs/theory/safety.md, trust)."""

from dataclasses import dataclass, replace

MAX_MISSED_BEATS = 3
MAX_AGE_S = 5.0
"""After so many regular beats in a row that do not confirm it, or so long, a pose is withheld."""


@dataclass(frozen=True, slots=True)
class Confirmation:
    """The last heart beat that confirmed the pose in use.

    Attributes:
        confirmed_s: when that was known.
        missed_beats: regular beats since that could not be compared with the pose, carried no information, or
            did not agree with it.
    """

    confirmed_s: float
    missed_beats: int = 0

    @property
    def until_s(self) -> float:
        """From then on the pose is withheld unless a beat confirms it; -inf where it already is."""
        return self.confirmed_s + MAX_AGE_S if self.missed_beats < MAX_MISSED_BEATS else float("-inf")

    def missed(self) -> "Confirmation":
        """After a regular beat that did not confirm the pose."""
        return replace(self, missed_beats=self.missed_beats + 1)
