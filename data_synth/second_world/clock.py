"""Clock of the second world: systole and early filling last as powers of RR, diastasis takes the rest.

In each beat the muscle is a little early or late relative to its R peak: noise of the gate.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, InvalidInputError, read_only_arrays


@dataclass(frozen=True, slots=True)
class CycleLaw:
    """Law by which the pre-operative cycle is retimed to another RR interval.

    Attributes:
        model_rr_s, es_fraction: timing of the acquisition.
        filling_share: share of its diastole that early filling takes.
        systole_power, filling_power: S = S₀ (RR/RR₀)^p, F = F₀ (RR/RR₀)^q.
    """

    model_rr_s: float
    es_fraction: float
    filling_share: float
    systole_power: float
    filling_power: float

    def model_phase(self, phi: FloatArray, rr_s: FloatArray) -> FloatArray:
        """Compute the model phase in [0, 1) at fraction `phi` of beats of `rr_s`, the same shape.

        The three parts are joined by a cubic whose slope at each joint is the harmonic mean of its sides.
        """
        phi, rr = np.broadcast_arrays(np.asarray(phi, dtype=np.float64), np.asarray(rr_s, dtype=np.float64))
        ratio = rr / self.model_rr_s
        systole = self.es_fraction * ratio ** (self.systole_power - 1.0)
        filling = (1.0 - self.es_fraction) * self.filling_share * ratio ** (self.filling_power - 1.0)
        # a short beat leaves at least 8 % of itself to diastasis, for any law
        squeeze = np.minimum(1.0, 0.92 / (systole + filling))
        x = np.stack([np.zeros_like(rr), systole * squeeze, (systole + filling) * squeeze, np.ones_like(rr)])
        y1, y2 = self.es_fraction, self.es_fraction + (1.0 - self.es_fraction) * self.filling_share
        y = np.array([0.0, y1, y2, 1.0])
        return np.asarray(np.clip(_periodic_cubic(phi, x, y), 0.0, np.nextafter(1.0, 0.0)))


def _periodic_cubic(phi: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Evaluate the monotone cubic through knots x (4, …), y (4,), with equal slopes at both ends."""
    slope = np.diff(y).reshape(3, *(1,) * phi.ndim) / np.diff(x, axis=0)
    joint = np.stack([_harmonic(slope[2], slope[0]), _harmonic(slope[0], slope[1]),
                      _harmonic(slope[1], slope[2]), _harmonic(slope[2], slope[0])])  # fmt: skip
    part = (phi >= x[1]).astype(np.int64) + (phi >= x[2]).astype(np.int64)

    def pick(values: FloatArray, index: IntArray) -> FloatArray:
        return np.asarray(np.take_along_axis(values, index[None], axis=0)[0])

    low, width = pick(x, part), pick(np.diff(x, axis=0), part)
    u = (phi - low) / width
    begin, end = pick(joint, part), pick(joint, part + 1)
    return np.asarray(
        y[part] * (1 + 2 * u) * (1 - u) ** 2
        + y[part + 1] * u**2 * (3 - 2 * u)
        + width * (begin * u * (1 - u) ** 2 - end * u**2 * (1 - u))
    )


def _harmonic(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(2.0 * a * b / (a + b))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class NoisyClock:
    """Clock from time to RR fraction, and to the phase of the muscle.

    Before the first and after the last R peak the nearest known RR interval is repeated.

    Attributes:
        r_peaks_s: (k,) R peaks, k >= 2, increasing.
        delay_s: (k,) delay of the muscle's beat after each of them, relative to the usual one.
        law: retiming.
    """

    r_peaks_s: FloatArray
    delay_s: FloatArray
    law: CycleLaw

    def __post_init__(self) -> None:
        peaks, delays = self.r_peaks_s, self.delay_s
        if len(peaks) < 2 or len(delays) != len(peaks) or (np.diff(peaks + delays) <= 0).any():
            raise InvalidInputError(
                f"{len(peaks)} R peaks with {len(delays)} delays; needed 2 or more, one each, increasing"
            )

    def phi(self, t_s: FloatArray) -> FloatArray:
        """Compute the (n,) fraction of the running RR interval since its R peak, in [0, 1)."""
        return _fraction(self.r_peaks_s, np.asarray(t_s, dtype=np.float64))[0]

    def model_phase(self, t_s: FloatArray) -> FloatArray:
        """Compute the muscle's phase in the pre-operative cycle, in [0, 1); any shape."""
        times = np.asarray(t_s, dtype=np.float64)
        fraction, rr_s = _fraction(self.r_peaks_s + self.delay_s, times.ravel())
        return self.law.model_phase(fraction, rr_s).reshape(times.shape)


def _fraction(beats_s: FloatArray, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the fraction of the running beat in [0, 1), and its length in s."""
    rr = np.diff(beats_s)
    index = np.clip(np.searchsorted(beats_s, t_s, side="right") - 1, 0, len(rr) - 1)
    fraction = (t_s - beats_s[index]) / rr[index] % 1.0
    return np.where(fraction >= 1.0, 0.0, fraction), rr[index]
