"""True clock of the beating heart: from time to RR fraction to phase of the pre-operative cycle."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats

SYSTOLE_S_PER_BPM = 0.002
"""Shortening of systole per beat/min (k about 2 ms; docs/theory/synthetic.md)."""

SYSTOLE_SHARE = (0.25, 0.65)
"""Bounds of systole as a share of the running RR interval."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class HeartClock:
    """Physiological two-segment timing of the true heart.

    Before the first and after the last R peak the nearest known RR interval is repeated.

    Attributes:
        r_peaks_s: (k,) R peaks, k >= 2, increasing.
        model_rr_s: RR interval of the pre-operative acquisition.
        es_fraction: end-systole as a fraction of that cycle.
        systole_s_per_bpm: k of the two-segment law.
    """

    r_peaks_s: FloatArray
    model_rr_s: float
    es_fraction: float
    systole_s_per_bpm: float = SYSTOLE_S_PER_BPM

    def __post_init__(self) -> None:
        peaks = frozen_floats(self.r_peaks_s, "R peaks", (None,))
        if len(peaks) < 2:
            raise InvalidInputError(f"{len(peaks)} R peaks; a heart clock needs at least 2")
        if (np.diff(peaks) <= 0).any():
            raise InvalidInputError("R peaks do not increase strictly; remove repeated beats")
        if not 0.05 < self.es_fraction < 0.95:
            raise InvalidInputError(f"end-systole at {self.es_fraction:g} of the cycle; needed 0.05 to 0.95")
        object.__setattr__(self, "r_peaks_s", peaks)

    def beat(self, t_s: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find the running beat's index (clipped to the known ones), the fraction of it, its RR in s."""
        t = np.asarray(t_s, dtype=np.float64)
        peaks, rr = self.r_peaks_s, np.diff(self.r_peaks_s)
        index = np.clip(np.searchsorted(peaks, t, side="right") - 1, 0, len(rr) - 1)
        fraction = (t - peaks[index]) / rr[index]
        inside = (t >= peaks[0]) & (t < peaks[-1])
        fraction = np.where(inside, np.clip(fraction, 0.0, np.nextafter(1.0, 0.0)), fraction % 1.0)
        return index, np.where(fraction >= 1.0, 0.0, fraction), rr[index]

    def phi(self, t_s: FloatArray) -> FloatArray:
        """Compute the fraction of the running RR interval since its R peak, in [0, 1)."""
        return self.beat(t_s)[1]

    def model_phase(self, t_s: FloatArray) -> FloatArray:
        """Compute the heart's phase in the pre-operative cycle, in [0, 1)."""
        _, phi, rr = self.beat(t_s)
        return two_segment_phase(phi, rr, self.model_rr_s, self.es_fraction, self.systole_s_per_bpm)


def two_segment_phase(
    phi: FloatArray,
    rr_s: FloatArray,
    model_rr_s: float,
    es_fraction: float,
    systole_s_per_bpm: float = SYSTOLE_S_PER_BPM,
) -> FloatArray:
    """Compute the model phase in [0, 1) at fraction `phi` of a beat of length `rr_s`.

    Systole lasts S = clip(S0 + k(HR0 − HR), 0.25 RR, 0.65 RR), S0 = es_fraction · model_rr_s, with the
    bounds widened to include es_fraction: the model's own rate maps to itself. The knots (0, 0),
    (S/RR, es_fraction), (1, 1) are joined by the monotone cubic of Fritsch and Butland with periodic end
    slopes, so the map is C1 within a beat and at the wrap.
    """
    rr = np.asarray(rr_s, dtype=np.float64)
    systole_s = es_fraction * model_rr_s + systole_s_per_bpm * (60.0 / model_rr_s - 60.0 / rr)
    lower, upper = min(SYSTOLE_SHARE[0], es_fraction), max(SYSTOLE_SHARE[1], es_fraction)
    x = np.clip(systole_s / rr, lower, upper)
    rise, fall = es_fraction / x, (1.0 - es_fraction) / (1.0 - x)
    slope_es = 3.0 / ((2.0 - x) / rise + (1.0 + x) / fall)
    slope_ed = 3.0 / ((1.0 + x) / fall + (2.0 - x) / rise)
    first = np.asarray(phi) < x
    width = np.where(first, x, 1.0 - x)
    u = np.where(first, phi, phi - x) / width
    low, high = np.where(first, 0.0, es_fraction), np.where(first, es_fraction, 1.0)
    slope_low, slope_high = np.where(first, slope_ed, slope_es), np.where(first, slope_es, slope_ed)
    phase = (
        low * (1 + 2 * u) * (1 - u) ** 2
        + high * u**2 * (3 - 2 * u)
        + width * (slope_low * u * (1 - u) ** 2 - slope_high * u**2 * (1 - u))
    )
    return np.asarray(np.clip(phase, 0.0, np.nextafter(1.0, 0.0)))
