"""Faults of the ECG and the heart's rhythm: electrodes off, mains hum, extrasystoles, atrial fibrillation."""

from collections.abc import Callable

import numpy as np

from data_synth.signals.rhythm import Beats
from dvf_ig.core import FloatArray
from dvf_ig.study.faults.patient import ECG_HZ

from .fault import BeatsChange, When

EARLY = 0.65
"""An early beat comes after this share of the interval."""
FIBRILLATION_CV = 0.25
"""Standard deviation over mean of intervals in atrial fibrillation."""


def flat(samples: FloatArray, when: When, rng: np.random.Generator) -> FloatArray:
    """Electrodes off: all leads hold one value."""
    return _samples_changed(samples, when, lambda part: np.broadcast_to(part[:1], part.shape))


def unplugged(samples: FloatArray, when: When, rng: np.random.Generator) -> FloatArray:
    """The recorder marks samples as missing."""
    return _samples_changed(samples, when, lambda part: np.full(part.shape, np.nan))


def mains_hum(samples: FloatArray, when: When, rng: np.random.Generator) -> FloatArray:
    """Electrodes off: open leads that pick up mains and noise in place of the heart."""

    def hum(part: FloatArray) -> FloatArray:
        t_s = np.arange(len(part)) / ECG_HZ
        wave = np.sin(2.0 * np.pi * 50.0 * t_s + rng.uniform(0.0, 2.0 * np.pi))
        return np.asarray(wave[:, None] + 0.05 * rng.standard_normal(part.shape))

    return _samples_changed(samples, when, hum)


def early_beats(count: int) -> BeatsChange:
    """So many ventricular extrasystoles in a row, and the pause after them."""

    def change(beats: Beats, when: When, rng: np.random.Generator) -> tuple[Beats, When]:
        r_s = beats.r_peaks_s
        k = int(np.searchsorted(r_s, when.begin_s))
        usual_s = float(r_s[k] - r_s[k - 1])
        run = r_s[k - 1] + EARLY * usual_s * np.arange(1, count + 1)
        after = r_s[r_s > run[-1] + (1.9 - EARLY) * usual_s]
        together = np.concatenate([r_s[:k], run, after])
        wide = (together >= run[0]) & (together <= run[-1])
        return Beats(together, wide), When(float(run[0]), float(after[0]))

    return change


def fibrillation(beats: Beats, when: When, rng: np.random.Generator) -> tuple[Beats, When]:
    """Intervals that follow no rule."""
    r_s = beats.r_peaks_s
    before, after = r_s[r_s < when.begin_s], r_s[r_s > when.end_s]
    usual_s = float(np.median(np.diff(before[-10:])))
    wild, last_s = [], float(before[-1])
    while last_s < when.end_s - 2.0 * usual_s:
        last_s += usual_s * float(np.clip(1.0 + FIBRILLATION_CV * rng.standard_normal(), 0.45, 1.8))
        wild.append(last_s)
    together = np.concatenate([before, wild, after])
    return Beats(together, np.zeros(len(together), dtype=np.bool_)), When(wild[0], wild[-1])


def _samples_changed(
    samples: FloatArray, when: When, change: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    first, last = (round(ECG_HZ * t_s) for t_s in (when.begin_s, when.end_s))
    return np.concatenate([samples[:first], change(samples[first:last]), samples[last:]])
