"""Forecast of ρ some tenths of a second ahead by a linear predictor, fitted to the last minute."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays

STEP_S = 0.1
HORIZONS = 5
"""Forecasts reach HORIZONS · STEP_S ahead."""
LAGS = np.array([0, 1, 2, 3, 5, 8, 12, 18, 26])
FIT_S = 60.0
LEAST_S = 12.0
"""Shorter histories are held at their last value."""
PRIOR = 0.05
"""SD of the noise of ρ that the ridge assumes; weights have a prior SD of 1."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Linear predictor of the change of ρ.

    Attributes:
        weights: (HORIZONS, lags) of the differences ρ(t − lag) − ρ(t).
        sigma: (HORIZONS,) RMS of what a fit to the first three quarters missed in the last.
    """

    weights: FloatArray
    sigma: FloatArray

    def at(self, recent: FloatArray, ahead_s: float) -> tuple[float, float]:
        """Compute ρ and its standard deviation `ahead_s` after the last of `recent`.

        Args:
            recent: ρ at 0, STEP_S, 2·STEP_S, … before now, the latest first; max(LAGS) + 1 of them.
        """
        x = recent[LAGS] - recent[0]
        step = min(max(ahead_s / STEP_S, 0.0), float(HORIZONS))
        grid = np.arange(HORIZONS + 1.0)
        change = np.interp(step, grid, np.concatenate([[0.0], self.weights @ x]))
        return float(recent[0] + change), float(np.interp(step, grid, np.concatenate([[0.0], self.sigma])))


def hold(spread: float) -> Forecast:
    """Return the predictor that holds the last value; `spread` is the SD of ρ over a breath."""
    sigma = spread * np.sqrt(2.0) * np.minimum(1.0, np.arange(1, HORIZONS + 1) * STEP_S)
    return Forecast(np.zeros((HORIZONS, len(LAGS))), sigma)


def fit_forecast(rho: FloatArray) -> Forecast:
    """Fit to (n,) ρ every STEP_S, the oldest first."""
    rho = rho[-round(FIT_S / STEP_S) :]
    first, last = int(LAGS[-1]), len(rho) - HORIZONS
    if last - first < round(LEAST_S / STEP_S):
        return hold(float(np.std(rho)) if len(rho) else 1.0)
    now = np.arange(first, last)
    x = rho[now[:, None] - LAGS] - rho[now][:, None]
    y = np.stack([rho[now + k] - rho[now] for k in range(1, HORIZONS + 1)], axis=1)
    checked = len(x) // 4
    missed = y[-checked:] - x[-checked:] @ _weights(x[:-checked], y[:-checked])
    return Forecast(_weights(x, y).T, np.sqrt((missed**2).mean(axis=0)))


def _weights(x: FloatArray, y: FloatArray) -> FloatArray:
    normal = x.T @ x / PRIOR**2 + np.eye(len(LAGS))
    return np.asarray(np.linalg.solve(normal, x.T @ y / PRIOR**2))
