"""Regression of a breathing signal that is sampled once a heart beat.

The samples are a Gaussian process: a periodic function of zero mean that loses its coherence over some
breaths (MacKay 1998; Roberts et al. 2013), a slow drift, and white noise,

    k(τ) = s² [ (e^{−2 sin²(πτ/P)/ℓ²} − c) / (1 − c) · e^{−τ²/2λ²} + e^{−τ²/2D²} + ν δ ],

with c the mean of the periodic factor. P, λ, ℓ and ν are those of the highest likelihood on a grid.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import i0e

from dvf_ig.core import FloatArray

FREQUENCIES_HZ = np.arange(0.1, 0.56, 0.01)
"""Six to 33 breaths a minute."""
REFINED = np.linspace(0.94, 1.06, 13)
"""Periods that are tried, relative to the one that is given."""
COHERENT_BREATHS = (1.5, 4.0)
ROUGHNESS = (0.6, 1.0)
NOISES = (0.02, 0.08, 0.3)
DRIFT_S = 25.0
BEATS_A_BREATH = 2.2
"""Fewest beats a breath in which it is still seen."""


@dataclass(frozen=True, slots=True)
class QuasiPeriodic:
    """Parameters of the process.

    Attributes:
        period_s: P; coherence_s: λ; roughness: ℓ; noise: ν.
        variance: s², of the periodic part and of the drift.
        gain: log-likelihood above that of drift and noise alone.
    """

    period_s: float
    coherence_s: float
    roughness: float
    noise: float
    variance: float
    gain: float

    def predict(self, t_s: FloatArray, values: FloatArray, at_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the periodic part and its standard deviation at (m,) times from (n,) samples."""
        across = self._periodic(at_s[:, None] - t_s)
        mean, explained = self._conditioned(t_s, values, across)
        return mean, np.sqrt(self.variance * np.maximum(1.0 - explained, 0.0))

    def forecast(self, t_s: FloatArray, values: FloatArray, at_s: float) -> tuple[float, float]:
        """Forecast a sample, drift and noise included, with its standard deviation."""
        apart = np.array([at_s - t_s])
        mean, explained = self._conditioned(t_s, values, self._periodic(apart) + _drift(apart))
        return float(mean[0]), math.sqrt(self.variance * (2.0 + self.noise - float(explained[0])))

    def _conditioned(
        self, t_s: FloatArray, values: FloatArray, across: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Compute means, and the share of the prior variance that the samples explain."""
        apart = t_s[:, None] - t_s
        factor = cho_factor(self._periodic(apart) + _drift(apart) + self.noise * np.eye(len(t_s)), lower=True)
        return across @ cho_solve(factor, values), np.einsum("mn,nm->m", across, cho_solve(factor, across.T))

    def _periodic(self, apart_s: FloatArray) -> FloatArray:
        return _periodic(apart_s, self.period_s, self.roughness) * _coherence(apart_s, self.coherence_s)


def fit_quasi_periodic(t_s: FloatArray, values: FloatArray, about_s: float) -> QuasiPeriodic:
    """Fit to (n,) samples of about zero mean, with a period near `about_s`."""
    apart = t_s[:, None] - t_s
    drift, noise = _drift(apart), np.eye(len(t_s))

    def fitted(period_s: float, breaths: float, roughness: float, level: float) -> QuasiPeriodic:
        coherence_s = breaths * period_s
        waves = _periodic(apart, period_s, roughness) * _coherence(apart, coherence_s)
        likelihood, variance = _likelihood(waves + drift + level * noise, values)
        return QuasiPeriodic(period_s, coherence_s, roughness, level, variance, likelihood - nothing)

    def best(found: list[QuasiPeriodic]) -> QuasiPeriodic:
        return max(found, key=lambda one: one.gain)

    nothing = max(_likelihood(drift + level * noise, values)[0] for level in (*NOISES, 1.0, 4.0, 20.0))
    shape = (COHERENT_BREATHS[-1], ROUGHNESS[-1], NOISES[1])
    nearest = best([fitted(period_s, *shape) for period_s in (about_s * REFINED).tolist()])
    shapes = product(COHERENT_BREATHS, ROUGHNESS, NOISES)
    return best([fitted(nearest.period_s, *one) for one in shapes])


def strongest_period_s(t_s: FloatArray, values: FloatArray) -> float:
    """Find the period of the oscillation that explains most of (n, columns) samples, beside linear drifts."""
    shortest_s = BEATS_A_BREATH * float(np.median(np.diff(t_s)))
    after_s = t_s - t_s.mean()
    steady = np.column_stack([np.ones(len(t_s)), after_s])
    without = _squares(values, steady)
    explained: dict[float, float] = {}
    for frequency_hz in FREQUENCIES_HZ[shortest_s * FREQUENCIES_HZ <= 1.0].tolist():
        angle = 2.0 * np.pi * frequency_hz * after_s
        left = _squares(values, np.column_stack([steady, np.cos(angle), np.sin(angle)]))
        explained[1.0 / frequency_hz] = float((1.0 - left / without).sum())
    return float(max(explained, key=lambda period_s: explained[period_s]))


def _squares(values: FloatArray, features: FloatArray) -> FloatArray:
    """Sum the squares of each column that a linear fit misses."""
    missed = values - features @ np.linalg.lstsq(features, values, rcond=None)[0]
    return np.asarray(np.maximum(np.square(missed).sum(axis=0), 1e-12))


def _periodic(apart_s: FloatArray, period_s: float, roughness: float) -> FloatArray:
    mean = float(i0e(roughness**-2.0))
    wave = np.exp(-2.0 * (np.sin(np.pi * apart_s / period_s) / roughness) ** 2)
    return np.asarray((wave - mean) / (1.0 - mean))


def _coherence(apart_s: FloatArray, coherence_s: float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * (apart_s / coherence_s) ** 2))


def _drift(apart_s: FloatArray) -> FloatArray:
    return _coherence(apart_s, DRIFT_S)


def _likelihood(covariance: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Compute the log-likelihood at the best variance, and that variance."""
    lower = np.linalg.cholesky(covariance)
    variance = float(np.square(np.linalg.solve(lower, values)).mean())
    likelihood = -0.5 * len(values) * math.log(variance) - float(np.log(np.diag(lower)).sum())
    return likelihood, variance
