"""Time stamps without their jitter: a causal regression of the last stamps on the count of frames."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression

from dvf_ig.core import FloatArray, InvalidInputError, PoseStream, read_only_arrays

RATE_REACH, RATES = 0.12, 73
"""Rates tried around one over the median step, which jitter of a fifth of a period moves as far."""


@dataclass(frozen=True, slots=True)
class StampOptions:
    """How stamps are filtered.

    Attributes:
        frames: length of the regression; the SD of white jitter falls by √(frames/4) (60: 3.9 times).
        warm_up: stamps that are passed on as they are before the first regression.
        max_shift_s: a stamp that the regression would move further starts a new one.
        max_gap_s: so does one that comes this long after the last.
        min_step: smallest step between two filtered stamps, as a share of the frame period.
    """

    frames: int = 60
    warm_up: int = 16
    max_shift_s: float = 0.08
    max_gap_s: float = 1.0
    min_step: float = 0.1

    def __post_init__(self) -> None:
        if not 3 <= self.warm_up < self.frames:
            raise InvalidInputError(
                f"a warm-up of {self.warm_up} stamps before a regression over {self.frames}; needed at least "
                "3, and fewer than the regression"
            )


class StampFilter:
    """Filters one clock's stamps as they arrive; it never sees a later one.

    Frames that were dropped are noticed by the time that passed and counted, so that a drop-out does not
    bend the line (a filter on the running count of frames that arrived is off by most of a period for its
    whole memory after each). Times are s.
    """

    def __init__(self, options: StampOptions | None = None) -> None:
        self.options = options or StampOptions()
        self.restarts = 0
        self._stamp_s: deque[float] = deque(maxlen=self.options.frames)
        self._period_s = 0.0
        self._last_s = -np.inf

    def push(self, stamp_s: float) -> float:
        """The filtered stamp of the frame that was stamped `stamp_s`.

        Raises:
            InvalidInputError: the stamp is not finite or not later than the one before.
        """
        if not np.isfinite(stamp_s) or (self._stamp_s and stamp_s <= self._stamp_s[-1]):
            last = self._stamp_s[-1] if self._stamp_s else None
            raise InvalidInputError(
                f"time stamp {stamp_s} s follows {last} s; needed finite, increasing stamps"
            )
        if self._stamp_s and stamp_s - self._stamp_s[-1] > self.options.max_gap_s:
            self._restart()
        filtered = self._filtered(stamp_s)
        if abs(filtered - stamp_s) > self.options.max_shift_s:
            self._restart()
            filtered = self._filtered(stamp_s)
        self._last_s = max(filtered, self._last_s + self.options.min_step * self._period_s)
        return self._last_s

    def _filtered(self, stamp_s: float) -> float:
        """Append a stamp and give the line's value at it; its own value while the line warms up."""
        self._stamp_s.append(stamp_s)
        if len(self._stamp_s) < self.options.warm_up:
            return stamp_s
        since = np.array(self._stamp_s) - stamp_s
        number = _frame_numbers(since)
        middle = number.mean()
        self._period_s = float((number - middle) @ since / ((number - middle) @ (number - middle)))
        return stamp_s + float(since.mean() + self._period_s * (number[-1] - middle))

    def _restart(self) -> None:
        self.restarts += 1
        self._stamp_s.clear()
        self._period_s = 0.0


def _frame_numbers(stamp_s: FloatArray) -> FloatArray:
    """(n,) whole, strictly increasing frame numbers of stamps, dropped frames counted.

    The frame rate is where the stamps' periodogram peaks near one over their median step: it knows no frame
    numbers, so that a wrong one cannot bend it. The numbers nearest to the stamps on that grid, in the sense
    of least squares, are the rounded isotonic regression of position minus count. The newest frame has
    nothing after it to say whether it was late or followed a drop-out: the likelier of the two is taken, from
    the jitter and the share of drop-outs in memory (Bayes decision between two normal distributions).
    """
    count = np.arange(len(stamp_s))
    rates = np.linspace(1.0 - RATE_REACH, 1.0 + RATE_REACH, RATES) / float(np.median(np.diff(stamp_s)))
    turns = np.exp(2j * np.pi * np.outer(rates, stamp_s)).mean(axis=1)
    best = int(np.abs(turns).argmax())
    position = rates[best] * stamp_s - float(np.angle(turns[best])) / (2 * np.pi)
    dropped = np.round(isotonic_regression(position - count).x)
    jitter = float((position - count - dropped)[:-1].std())
    share = (dropped[-2] - dropped[0] + 1.0) / (dropped[-2] - dropped[0] + len(stamp_s) + 1.0)
    if position[-1] - count[-1] - dropped[-2] < 0.5 + jitter**2 * np.log((1.0 - share) / share):
        dropped[-1] = dropped[-2]
    return np.asarray(count + dropped)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FilteredStamps:
    """Stamps after the filter.

    Attributes:
        t_s: (n,) strictly increasing.
        shift_s: (n,) t_s minus the stamps as given.
        restarts: how often the regression began anew, at long gaps and jumps of the clock.
    """

    t_s: FloatArray
    shift_s: FloatArray
    restarts: int


def filter_stamps(t_s: FloatArray, *, options: StampOptions | None = None) -> FilteredStamps:
    """All stamps of a recording, each filtered with those before it only.

    Args:
        t_s: (n,) increasing, s.
        options: see StampOptions.
    Raises:
        InvalidInputError: stamps that are not finite or do not increase.
    Source: PLUS vtkPlusTimestampedCircularBuffer (regression of the stamps on the frame count).
    Differs from source: dropped frames are counted; a jump of the clock starts a new line.
    """
    clock = StampFilter(options)
    filtered = np.array([clock.push(float(stamp)) for stamp in t_s])
    return FilteredStamps(filtered, filtered - t_s, clock.restarts)


def filtered_stream(poses: PoseStream, *, options: StampOptions | None = None) -> PoseStream:
    """The same poses on filtered stamps; samples that are not valid count as frames and stay invalid."""
    times = filter_stamps(poses.t_s, options=options).t_s
    return PoseStream(poses.target, poses.source, times, poses.rotations, poses.translations_mm, poses.valid)
