"""Write an ECG as EDF, in the steps in which it was digitised where that is possible."""

from pathlib import Path

import edfio
import numpy as np

from dvf_ig.core import FloatArray, Signal

LEVELS = 65535


def write_ecg_edf(signal: Signal, path: Path) -> float:
    """Write all leads with one step, mV; the largest error that this makes.

    EDF has 16 bits, keeps no start but a time of day, and cannot hold missing samples.
    """
    low, high = float(signal.samples.min()), float(signal.samples.max())
    step = step_of(signal.samples) or float(f"{(high - low) / LEVELS * 1.0001:.3g}")
    middle = round((low + high) / 2 / step) if high > 32767 * step or low < -32768 * step else 0
    limits = ((middle - 32768) * step, (middle + 32767) * step)
    leads = [
        edfio.EdfSignal(
            lead,
            signal.rate_hz,
            label=f"ECG {name}",
            physical_dimension=signal.unit,
            physical_range=(float(f"{limits[0]:.6g}"), float(f"{limits[1]:.6g}")),
        )
        for name, lead in zip(signal.leads, signal.samples.T, strict=True)
    ]
    edfio.Edf(leads).write(path)
    return step / 2 if step_of(signal.samples) is None else 0.0


def step_of(samples: FloatArray) -> float | None:
    """The step of which all samples are multiples, where 16 bits hold that range; else None."""
    levels = np.unique(samples)
    step = float(f"{np.diff(levels)[np.diff(levels) > 1e-9].min():.9g}")
    whole = np.abs(levels / step - np.rint(levels / step)).max() < 1e-6
    return step if whole and np.abs(levels).max() < 32767 * step else None
