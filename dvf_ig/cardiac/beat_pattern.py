"""Probability that the current beat ends early or late, learnt from the pattern of early and late beats."""

from collections import defaultdict
from enum import IntEnum

import numpy as np

from dvf_ig.core import FloatArray


class BeatKind(IntEnum):
    """End of an interval: as expected (after an early beat: with its pause), early, or late."""

    NORMAL = 0
    EARLY = 1
    LATE = 2


LONGEST_RUN = 12
"""Runs of normal beats longer than this are treated as equal."""
RUNS = 2
"""Number of earlier runs in the longest context, in addition to the current one."""
BACKOFF_COUNT = 3.0
"""Weight of the shorter context's estimate, in observations."""
FORGETTING = 0.98
"""Factor on the counts of a context at each new observation."""
PRIOR = (0.98, 0.01, 0.01)
"""Probabilities assumed before the first observation."""
PRIOR_COUNT = 20.0
"""Weight of PRIOR, in observations."""


class BeatPattern:
    """Probabilities of how the next interval ends: a variable-order Markov model of run lengths.

    A context is the length of the current run of normal beats with the kind of beat that began it; longer
    contexts also hold the runs before. Each backs off to the shorter one while it has few observations.
    Bigeminy and trigeminy are forecast once observed a few times; early beats that come at random stay
    uncertain.
    """

    def __init__(self) -> None:
        self._counts: defaultdict[tuple[int, ...], FloatArray] = defaultdict(lambda: np.zeros(3))
        self._counts[()] = PRIOR_COUNT * np.array(PRIOR)
        self._runs = [LONGEST_RUN]  # the current one first
        self._begun_by = BeatKind.NORMAL

    def add(self, kind: BeatKind) -> None:
        """Record how an interval ended."""
        for context in self._contexts():
            counts = self._counts[context]
            counts *= FORGETTING
            counts[kind] += 1.0
        if kind == BeatKind.NORMAL:
            self._runs[0] = min(self._runs[0] + 1, LONGEST_RUN)
        else:
            self._runs = [0, *self._runs][: RUNS + 1]
            self._begun_by = kind

    def probabilities(self) -> FloatArray:
        """Return (3,) probabilities by BeatKind for the current interval."""
        estimate = np.array(PRIOR)
        for context in self._contexts():
            counts = self._counts[context]
            weight = BACKOFF_COUNT
            estimate = (counts + weight * estimate) / (counts.sum() + weight)
        return np.asarray(estimate)

    def _contexts(self) -> list[tuple[int, ...]]:
        """List the contexts, the shortest first."""
        longest = [int(self._begun_by), *self._runs]
        return [(), *(tuple(longest[: depth + 2]) for depth in range(len(self._runs)))]
