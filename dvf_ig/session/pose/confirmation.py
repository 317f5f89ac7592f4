"""How long a pose may be used that no heart beat has confirmed (docs/theory/safety.md, trust)."""

from dataclasses import dataclass, replace

MAX_MISSED_BEATS, MAX_AGE_S = 3, 5.0
"""After so many regular beats in a row that do not confirm it, or so long, a pose is withheld."""
MAX_BOUND_MM = 5.0
"""95 % bound on the error of a pose that is withheld: a force on a pose further off is a hazard."""
AGEING_MM_PER_S = 10.0 / 60.0
"""So fast that bound grows while no beat confirms the pose: a patient's creep by 10 mm a minute."""


@dataclass(frozen=True, slots=True)
class Confirmation:
    """The last heart beat that confirmed the pose in use.

    Attributes:
        confirmed_s: when that was known.
        tre_bound_mm: 95 % bound on the error of the pose then.
        missed_beats: regular beats since that could not be compared with the pose, carried no information, or
            did not agree with it.
    """

    confirmed_s: float
    tre_bound_mm: float
    missed_beats: int = 0

    @property
    def until_s(self) -> float:
        """From then on the pose is withheld unless a beat confirms it; -inf where it already is."""
        lasts_s = min(MAX_AGE_S, (MAX_BOUND_MM - self.tre_bound_mm) / AGEING_MM_PER_S)
        if self.missed_beats >= MAX_MISSED_BEATS or lasts_s <= 0.0:
            return float("-inf")
        return self.confirmed_s + lasts_s

    def bound_mm(self, now_s: float) -> float:
        """95 % bound on the error of the pose at `now_s`."""
        return self.tre_bound_mm + AGEING_MM_PER_S * (now_s - self.confirmed_s)

    def missed(self) -> "Confirmation":
        """After a regular beat that did not confirm the pose."""
        return replace(self, missed_beats=self.missed_beats + 1)

    def changed(self, tre_bound_mm: float) -> "Confirmation":
        """The pose changed, or became less certain, without a beat that confirms it."""
        return replace(self, tre_bound_mm=tre_bound_mm)
