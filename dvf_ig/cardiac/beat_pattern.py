"""How the running beat is likely to end, learnt from where early and late beats came before."""

from collections import defaultdict
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from dvf_ig.core import FloatArray


class BeatKind(IntEnum):
    """How an interval ended: as expected (after an early beat: with its pause), early, or late."""

    NORMAL = 0
    EARLY = 1
    LATE = 2


@dataclass(frozen=True, slots=True)
class PatternOptions:
    """How patterns are learnt.

    Attributes:
        longest_run: runs of normal beats longer than this are alike.
        runs: how many earlier runs make a situation, besides the running one.
        occasions: with how many occasions a general situation speaks for a special one.
        fading: what is left of an occasion each time its situation comes up again.
        first: chances assumed before anything was seen.
        first_occasions: with how many occasions they count.
    """

    longest_run: int = 12
    runs: int = 2
    occasions: float = 3.0
    fading: float = 0.98
    first: tuple[float, float, float] = (0.98, 0.01, 0.01)
    first_occasions: float = 20.0


class BeatPattern:
    """Chances of how the next interval ends, given the runs of normal beats between the last irregular ones.

    A situation is the length of the running run with the kind of beat that began it; a more special one also
    knows the runs before. Each falls back on the more general one while it has been seen rarely (a
    variable-order Markov model of run lengths). Bigeminy and trigeminy are forecast once seen a few times;
    early beats that come at random stay uncertain.
    """

    def __init__(self, options: PatternOptions | None = None) -> None:
        self._options = options or PatternOptions()
        self._counts: defaultdict[tuple[int, ...], FloatArray] = defaultdict(lambda: np.zeros(3))
        self._counts[()] = self._options.first_occasions * np.array(self._options.first)
        self._runs = [self._options.longest_run]  # the running one first
        self._begun_by = BeatKind.NORMAL

    def add(self, kind: BeatKind) -> None:
        """How an interval ended."""
        for situation in self._situations():
            counts = self._counts[situation]
            counts *= self._options.fading
            counts[kind] += 1.0
        if kind == BeatKind.NORMAL:
            self._runs[0] = min(self._runs[0] + 1, self._options.longest_run)
        else:
            self._runs = [0, *self._runs][: self._options.runs + 1]
            self._begun_by = kind

    def chances(self) -> FloatArray:
        """(3,) by BeatKind, of the running interval."""
        chances = np.array(self._options.first)
        for situation in self._situations():
            counts = self._counts[situation]
            chances = (counts + self._options.occasions * chances) / (counts.sum() + self._options.occasions)
        return np.asarray(chances)

    def _situations(self) -> list[tuple[int, ...]]:
        """The general ones first."""
        known = [int(self._begun_by), *self._runs]
        return [(), *(tuple(known[: depth + 2]) for depth in range(len(self._runs)))]
