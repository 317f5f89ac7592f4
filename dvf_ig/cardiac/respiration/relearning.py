"""Breathing clock that learns its scale again once depth or level of the breath have changed for good."""

from dvf_ig.core import FloatArray

from .breath_clock import BreathClock, BreathClockOptions

RELEARN_BREATHS = 5
"""Ordinary breaths in a row by a new scale, after which it replaces one by which no breath is ordinary."""


class RelearningClock:
    """A `BreathClock`, and while it finds no ordinary breath a second one that begins to learn.

    Attributes:
        clock: the one in use; its features begin anew when `changes` counts up.
        changes: how often breathing has changed for good.
    """

    def __init__(self, options: BreathClockOptions | None = None) -> None:
        self._options = options
        self.clock = BreathClock(options)
        self.changes = 0
        self._next: BreathClock | None = None

    def push(self, t_s: FloatArray, values: FloatArray) -> None:
        """Add samples (n,), (n, columns); see `BreathClock.push`."""
        for k in range(len(t_s)):
            self._push(t_s[k : k + 1], values[k : k + 1])

    def _push(self, t_s: FloatArray, values: FloatArray) -> None:
        self.clock.push(t_s, values)
        if not self.clock.astray:
            self._next = None
            return
        if self._next is None or self._next.astray:
            self._next = BreathClock(self._options)
        self._next.push(t_s, values)
        if self._next.ordinary_breaths >= RELEARN_BREATHS:
            self.clock, self._next = self._next, None
            self.changes += 1
