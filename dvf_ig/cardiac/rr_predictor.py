"""Predictors of the next RR interval from the intervals before it."""

from collections import deque
from collections.abc import Callable
from typing import Literal, Protocol

import numpy as np

from dvf_ig.core import InvalidInputError

PredictorName = Literal["ar8", "ewma", "last"]

AR_ORDER = 8
AR_FORGETTING = 0.98
EWMA_GAIN = 0.3
MEAN_GAIN = 0.1
AR_LIMITS = (0.7, 1.4)
"""A prediction is kept within these multiples of the median of the last beats."""


class RrPredictor(Protocol):
    """Predictor of the next RR interval (s) from those already added."""

    def add(self, rr_s: float) -> None:
        """Add one finished interval, in order."""

    def predict(self) -> float:
        """Predict the next interval; NaN before the first."""


class LastRr:
    """Predictor that repeats the last interval."""

    def __init__(self) -> None:
        self._last = float("nan")

    def add(self, rr_s: float) -> None:
        self._last = rr_s

    def predict(self) -> float:
        return self._last


class EwmaRr:
    """Predictor by an exponentially weighted mean, gain 0.3."""

    def __init__(self) -> None:
        self._mean = float("nan")

    def add(self, rr_s: float) -> None:
        self._mean = rr_s if np.isnan(self._mean) else self._mean + EWMA_GAIN * (rr_s - self._mean)

    def predict(self) -> float:
        return self._mean


class AutoregressiveRr:
    """Predictor by recursive least squares on the last eight deviations from a running mean.

    Respiratory sinus arrhythmia repeats every few beats; a running mean cannot follow it, this predictor can.
    Source: Haykin, Adaptive Filter Theory, RLS with exponential forgetting.
    """

    def __init__(self) -> None:
        self._mean = float("nan")
        self._recent: deque[float] = deque(maxlen=AR_ORDER)
        self._weights = np.zeros(AR_ORDER)
        self._weights[0] = 0.5
        self._inverse = np.eye(AR_ORDER) * 100.0

    def add(self, rr_s: float) -> None:
        if np.isnan(self._mean):
            self._mean = rr_s
        if len(self._recent) == AR_ORDER:
            past = self._past()
            gain = self._inverse @ past
            gain /= AR_FORGETTING + past @ gain
            error = (rr_s - self._mean) / self._mean - self._weights @ past
            self._weights = self._weights + gain * error
            inverse = (self._inverse - np.outer(gain, past @ self._inverse)) / AR_FORGETTING
            self._inverse = np.clip(0.5 * (inverse + inverse.T), -1e6, 1e6)
        self._mean += MEAN_GAIN * (rr_s - self._mean)
        self._recent.appendleft(rr_s)

    def predict(self) -> float:
        if len(self._recent) < AR_ORDER:
            return float(np.mean(self._recent)) if self._recent else float("nan")
        middle = float(np.median(self._recent))
        raw = self._mean * (1.0 + float(self._weights @ self._past()))
        return float(np.clip(raw, AR_LIMITS[0] * middle, AR_LIMITS[1] * middle))

    def _past(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Return (8,) relative deviations, the latest first, limited to 30 %."""
        return np.asarray(np.clip((np.array(self._recent) - self._mean) / self._mean, -0.3, 0.3))


PREDICTORS: dict[PredictorName, Callable[[], RrPredictor]] = {
    "ar8": AutoregressiveRr,
    "ewma": EwmaRr,
    "last": LastRr,
}


def make_predictor(name: PredictorName) -> RrPredictor:
    """Create a predictor by name.

    Raises:
        InvalidInputError: unknown name.
    """
    if name not in PREDICTORS:
        raise InvalidInputError(f"RR predictor '{name}' is unknown; choose {', '.join(PREDICTORS)}")
    return PREDICTORS[name]()
