"""Probability that the current beat ends early or late, learnt from the pattern of early and late beats."""

from collections import defaultdict
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from dvf_ig.core import FloatArray


class BeatKind(IntEnum):
    """End of an interval: as expected (after an early beat: with its pause), early, or late."""

    NORMAL = 0
    EARLY = 1
    LATE = 2


@dataclass(frozen=True, slots=True)
class BeatPatternOptions:
    """Options of the pattern model.

    Attributes:
        longest_run: runs of normal beats longer than this are treated as equal.
        runs: number of earlier runs in the longest context, in addition to the current one.
        backoff_count: weight of the shorter context's estimate, in observations.
        forgetting: factor on the counts of a context at each new observation.
        prior: probabilities assumed before the first observation.
        prior_count: their weight, in observations.
    """

    longest_run: int = 12
    runs: int = 2
    backoff_count: float = 3.0
    forgetting: float = 0.98
    prior: tuple[float, float, float] = (0.98, 0.01, 0.01)
    prior_count: float = 20.0


class BeatPattern:
    """Probabilities of how the next interval ends: a variable-order Markov model of run lengths.

    A context is the length of the current run of normal beats with the kind of beat that began it; longer
    contexts also hold the runs before. Each backs off to the shorter one while it has few observations.
    Bigeminy and trigeminy are forecast once observed a few times; early beats that come at random stay
    uncertain.
    """

    def __init__(self, options: BeatPatternOptions | None = None) -> None:
        self._options = options or BeatPatternOptions()
        self._counts: defaultdict[tuple[int, ...], FloatArray] = defaultdict(lambda: np.zeros(3))
        self._counts[()] = self._options.prior_count * np.array(self._options.prior)
        self._runs = [self._options.longest_run]  # the current one first
        self._begun_by = BeatKind.NORMAL

    def add(self, kind: BeatKind) -> None:
        """Record how an interval ended."""
        for context in self._contexts():
            counts = self._counts[context]
            counts *= self._options.forgetting
            counts[kind] += 1.0
        if kind == BeatKind.NORMAL:
            self._runs[0] = min(self._runs[0] + 1, self._options.longest_run)
        else:
            self._runs = [0, *self._runs][: self._options.runs + 1]
            self._begun_by = kind

    def probabilities(self) -> FloatArray:
        """Return (3,) probabilities by BeatKind for the current interval."""
        estimate = np.array(self._options.prior)
        for context in self._contexts():
            counts = self._counts[context]
            weight = self._options.backoff_count
            estimate = (counts + weight * estimate) / (counts.sum() + weight)
        return np.asarray(estimate)

    def _contexts(self) -> list[tuple[int, ...]]:
        """List the contexts, the shortest first."""
        longest = [int(self._begun_by), *self._runs]
        return [(), *(tuple(longest[: depth + 2]) for depth in range(len(self._runs)))]
