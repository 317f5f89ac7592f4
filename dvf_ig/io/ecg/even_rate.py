"""Estimate the sampling rate of evenly spaced, possibly rounded, sample times."""

from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError


def even_rate_hz(path: Path, t_s: FloatArray) -> float:
    """Estimate the sampling rate of evenly spaced times: the roundest one that gives exactly these times.

    Raises:
        UnreadableFileError: a time is not finite, repeats, or is more than half a sample out of step.
    """
    steps = np.diff(t_s)
    step = float(np.median(steps))
    if step == 0:
        raise UnreadableFileError(
            f"{path}: most times repeat; they are written too coarsely, leave their column "
            "out and give the sampling rate in Hz",
            settings=("ecg.rate_hz",),
        )
    uneven = ~(np.abs(steps - step) <= 0.5 * step)
    drift = np.abs(t_s - np.linspace(t_s[0], t_s[-1], len(t_s)))
    if uneven.any() or not (drift <= 2 * step).all():
        row = int(np.flatnonzero(uneven)[0]) if uneven.any() else int(drift.argmax())
        raise UnreadableFileError(
            f"{path}: samples are not evenly spaced (row {row + 1}, at {t_s[row]:g} s, is out of step with "
            f"{step:g} s elsewhere); resample to a fixed rate, missing samples as nan"
        )
    estimate = float((len(t_s) - 1) / (t_s[-1] - t_s[0]))
    index = np.arange(len(t_s))
    for candidate in (*(round(estimate, digits) for digits in range(10)), *_neighbours(estimate)):
        if candidate > 0 and np.array_equal(t_s[0] + index / candidate, t_s):
            return candidate
    return estimate


def _neighbours(value: float, count: int = 8) -> list[float]:
    """List the floats closest to `value`, nearest first."""
    up, down, out = value, value, [value]
    for _ in range(count):
        up, down = float(np.nextafter(up, np.inf)), float(np.nextafter(down, 0.0))
        out += [up, down]
    return out
