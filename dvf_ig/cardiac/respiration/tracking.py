"""Causal breathing over a recording: each time uses only the samples up to it."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Progress, Respiration, read_only_arrays, untold

from .breath_clock import BreathClock

RELEARN_BREATHS = 5
"""Ordinary breaths in a row by a new scale, after which it replaces one by which no breath is ordinary."""


class RelearningClock:
    """A `BreathClock`, and while it finds no ordinary breath a second one that begins to learn.

    Attributes:
        clock: the one in use; its features begin anew when `changes` counts up.
        changes: how often breathing has changed for good.
    """

    def __init__(self) -> None:
        self.clock = BreathClock()
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
            self._next = BreathClock()
        self._next.push(t_s, values)
        if self._next.ordinary_breaths >= RELEARN_BREATHS:
            self.clock, self._next = self._next, None
            self.changes += 1


IRREGULAR = 0.3
"""Standard deviation of the length of breaths over its mean, beyond which they have no rate."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BreathTrack:
    """Breathing at each time, as known from the past alone.

    Attributes:
        t_s: (n,) increasing.
        rho, sigma_rho, phase, period_s: (n,) see `BreathReading`.
        state, event: (n,) `BreathState` and `BreathEvent` values.
        onsets_s: (k,) beginnings of breaths.
    """

    t_s: FloatArray
    rho: FloatArray
    sigma_rho: FloatArray
    phase: FloatArray
    period_s: FloatArray
    state: IntArray
    event: IntArray
    onsets_s: FloatArray

    def rate_per_min(self, start_s: float, stop_s: float) -> float:
        """Compute breaths a minute between two times; NaN with fewer than three, or if they are irregular."""
        onsets = self.onsets_s[(self.onsets_s >= start_s) & (self.onsets_s < stop_s)]
        if len(onsets) < 3:
            return float("nan")
        lengths_s = np.diff(onsets)
        if lengths_s.std() > IRREGULAR * lengths_s.mean():
            return float("nan")
        return float(60.0 * (len(onsets) - 1) / (onsets[-1] - onsets[0]))


def track_breathing(
    recorded: Respiration,
    t_s: FloatArray,
    *,
    progress: Progress = untold,
) -> BreathTrack:
    """Follow breathing over a recording.

    Args:
        t_s: (n,) strictly increasing times at which the clock is read.
        progress: called with the fraction done.
    """
    following, times = RelearningClock(), np.asarray(t_s, dtype=np.float64)
    rows, codes, onsets = np.empty((len(times), 4)), np.empty((len(times), 2), dtype=np.int64), set[float]()
    first = 0
    for i, at_s in enumerate(times.tolist()):
        last = int(np.searchsorted(recorded.t_s, at_s, side="right"))
        following.push(recorded.t_s[first:last], recorded.values[first:last])
        first = last
        clock = following.clock
        reading = clock.reading(at_s)
        rows[i] = reading.rho, reading.sigma_rho, reading.phase, reading.period_s
        codes[i] = reading.state, reading.event
        onsets.update(clock.onsets_s)
        if i % 100 == 0:
            progress(i / len(times))
    rho, sigma, phase, period = rows.T
    return BreathTrack(times, rho, sigma, phase, period, codes[:, 0], codes[:, 1], np.array(sorted(onsets)))
