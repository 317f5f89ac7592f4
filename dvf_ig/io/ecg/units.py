"""Convert samples of an ECG to mV from the units that recorders write."""

from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError

_TO_MV = {"mv": 1.0, "uv": 1e-3, "µv": 1e-3, "μv": 1e-3, "v": 1e3}


def in_millivolts(path: Path, samples: FloatArray, units: list[str]) -> FloatArray:
    """Convert (n, leads) samples to mV.

    Args:
        units: of each lead.
    Raises:
        UnreadableFileError: a unit that is no voltage.
    """
    unknown = sorted({unit for unit in units if unit.strip().lower() not in _TO_MV})
    if unknown:
        raise UnreadableFileError(
            f"{path}: leads are in {', '.join(map(repr, unknown))}; needed mV, uV or V (calibrate the record)"
        )
    scale = np.array([_TO_MV[unit.strip().lower()] for unit in units])
    return samples if (scale == 1).all() else np.asarray(samples * scale)
