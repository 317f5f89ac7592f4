"""Smooth random functions of time: slow variation of a hand's motion, and its tremor."""

from collections.abc import Callable

import numpy as np

from dvf_ig.core import FloatArray


def smooth_noise(
    columns: int, low_hz: float, high_hz: float, rng: np.random.Generator, waves: int = 12
) -> Callable[[FloatArray], FloatArray]:
    """Draw a function of time with unit RMS per column and a spectrum inside a band.

    Returns:
        times (n,) s to values (n, columns): a sum of sinusoids at random frequencies and phases, hence
        smooth, defined at every time, and independent of its sampling.
    """
    frequencies = rng.uniform(low_hz, high_hz, (columns, waves))
    phases = rng.uniform(0, 2 * np.pi, (columns, waves))

    def values(t_s: FloatArray) -> FloatArray:
        turns = 2 * np.pi * frequencies[None] * np.asarray(t_s)[:, None, None] + phases[None]
        return np.asarray(np.sin(turns).sum(axis=2) * np.sqrt(2.0 / waves))

    return values
