"""Forecast of cardiac phase: phase, its uncertainty and its state from a time on, as known then.

Between two events of the ECG unwrapped phase (whole beats plus phase) is a closed form of time. With the last
R peak at R, the predicted length RR of its beat, and φ₀ the phase at `since_s` = t₀,

    target   T(t) = cycles + (t − R)/RR
    phase    Φ(t) = max(φ₀, min(T(t), φ₀ + catch_up (t − t₀)/RR)),   φ = Φ mod 1
    σ_φ²     = (spread (t − R)/RR)² + (r_timing_s/RR)² + (T − Φ)²

so phase waits for a late R peak, catches up with an early one at a bounded rate, and never decreases.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dvf_ig.core.arrays import BoolArray, FloatArray, IntArray, frozen, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError


class PhaseState(IntEnum):
    """State of the cardiac phase; only with LOCKED may it be used."""

    INIT = 0
    LOCKED = 1
    SUSPECT = 2
    LOST = 3
    IRREGULAR = 4


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PhaseTrack:
    """Phase at each time, as estimated from the past alone.

    Attributes:
        t_s: (n,) increasing.
        phi: (n,) in [0, 1), fraction of the RR interval since the last R peak.
        sigma_phi: (n,) one standard deviation of phi.
        rr_s: (n,) predicted length of the running beat.
        state: (n,) PhaseState values.
    """

    t_s: FloatArray
    phi: FloatArray
    sigma_phi: FloatArray
    rr_s: FloatArray
    state: IntArray

    def __post_init__(self) -> None:
        t_s = frozen_floats(self.t_s, "phase times", (None,))
        n = len(t_s)
        if (np.diff(t_s) <= 0).any():
            raise InvalidInputError("phase times do not increase strictly")
        object.__setattr__(self, "t_s", t_s)
        for name in ("phi", "sigma_phi", "rr_s"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), name, (n,), finite=False))
        object.__setattr__(self, "state", frozen(self.state, "phase state", (n,), np.int64))

    @property
    def valid(self) -> BoolArray:
        """Return (n,) True if the state is LOCKED."""
        return np.asarray(self.state == int(PhaseState.LOCKED))


class PhaseReading(NamedTuple):
    """Phase in [0, 1), its standard deviation, predicted length of the current beat, state, dφ/dt."""

    phi: float
    sigma_phi: float
    rr_s: float
    state: PhaseState
    rate_hz: float


class PhaseReadings(NamedTuple):
    """`PhaseReading` at n times, each an (n,) array."""

    phi: FloatArray
    sigma_phi: FloatArray
    rr_s: FloatArray
    state: IntArray
    rate_hz: FloatArray


@dataclass(frozen=True, slots=True)
class PhaseForecast:
    """Phase from a time on, until the next event of the ECG: a pure function of time.

    Before `since_s`, and at non-finite times, phase and σ_φ are NaN and the state is INIT. After `until_s`
    the state is `state_after`, which is never LOCKED.

    Attributes:
        since_s: time of the event from which on it holds.
        until_s: end of `state`: then an expected beat is overdue.
        state, state_after: state until `until_s`, and after it.
        phi: phase at `since_s`, in [0, 1).
        r_s: time of the last R peak; NaN before the first.
        cycles: whole cycles of the target at that R peak, on the count in which `phi` lies in [0, 1).
        rr_s: predicted length of the current beat; NaN before the first interval.
        spread: standard deviation of that length, relative to it.
        catch_up: largest rate of phase, as a multiple of the predicted heart rate.
        r_timing_s: standard deviation of the time of an R peak.
    """

    since_s: float
    until_s: float
    state: PhaseState
    state_after: PhaseState
    phi: float
    r_s: float
    cycles: float
    rr_s: float
    spread: float
    catch_up: float
    r_timing_s: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.phi < 1.0 or not self.until_s >= self.since_s:
            raise InvalidInputError(
                f"a forecast of phase {self.phi:g} from {self.since_s:g} s to {self.until_s:g} s; needed a "
                "phase in [0, 1) and an end that is not before the beginning"
            )
        if self.state_after == PhaseState.LOCKED:
            raise InvalidInputError("a forecast is never LOCKED after its end")
        if self.state == PhaseState.LOCKED and not 0 < self.rr_s < math.inf:
            raise InvalidInputError(f"a forecast is LOCKED with RR {self.rr_s:g} s; needed above 0")
        if self.state == PhaseState.LOCKED and not math.isfinite(self.r_s + self.cycles + self.since_s):
            raise InvalidInputError(
                f"a forecast is LOCKED from {self.since_s:g} s on an R peak at {self.r_s:g} s, "
                f"{self.cycles:g} cycles; needed numbers"
            )

    @classmethod
    def unknown(cls) -> "PhaseForecast":
        """Build the forecast before the first R peak."""
        nan, init = math.nan, PhaseState.INIT
        return cls(-math.inf, math.inf, init, init, 0.0, nan, 0.0, nan, nan, 1.0, 0.0)

    def at(self, t_s: float) -> PhaseReading:
        """Compute phase at one time."""
        readings = self.at_many(np.array([t_s]))
        phi, sigma, rr, state, rate = (column[0].item() for column in readings)
        return PhaseReading(phi, sigma, rr, PhaseState(state), rate)

    def at_many(self, t_s: FloatArray) -> PhaseReadings:
        """Compute phase at (n,) times, in any order."""
        t, rr_s = np.asarray(t_s, dtype=np.float64), np.float64(self.rr_s)
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            target, caught = self._target(t), self._caught_up(t)
            unwrapped = self.unwrapped(t)
            share = np.maximum(0.0, t - self.r_s) / rr_s
            lag = target - unwrapped
            variance = (self.spread * share) ** 2 + (self.r_timing_s / rr_s) ** 2 + lag**2
            rate = np.where(caught < target, self.catch_up, np.where(target > self.phi, 1.0, 0.0))
            phi = unwrapped - np.floor(unwrapped)
            rate_hz = rate / rr_s
            valid = (t >= self.since_s) & np.isfinite(phi) & ~np.isinf(variance)
        state = np.where(t <= self.until_s, int(self.state), int(self.state_after))
        return PhaseReadings(
            np.where(valid, phi, np.nan),
            np.where(valid, np.sqrt(variance), np.nan),
            np.full(t.shape, self.rr_s),
            np.where(valid, state, int(PhaseState.INIT)),
            np.where(valid & (rr_s > 0), rate_hz, 0.0),
        )

    def unwrapped(self, t_s: FloatArray | float) -> FloatArray:
        """Compute (...) Φ on the count in which it is `phi` at `since_s`; times not before that."""
        if not self.rr_s > 0:
            return np.full(np.shape(t_s), self.phi)
        t = np.asarray(t_s, dtype=np.float64)
        return np.asarray(np.maximum(self.phi, np.minimum(self._target(t), self._caught_up(t))))

    def _target(self, t_s: FloatArray) -> FloatArray:
        return np.asarray(self.cycles + (t_s - self.r_s) / np.float64(self.rr_s))

    def _caught_up(self, t_s: FloatArray) -> FloatArray:
        return np.asarray(self.phi + self.catch_up * (t_s - self.since_s) / np.float64(self.rr_s))
