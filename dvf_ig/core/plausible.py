"""Largest plausible numbers of an operating room: beyond them a unit is wrong or data are damaged."""

from typing import Any

import numpy as np

from .errors import InvalidInputError

LENGTH_MM = 1e6
"""Largest coordinate: a kilometre, as trackers reach 5 m and scanners 2 m."""
TIME_S = 1e10
"""Largest time stamp: seconds since 1970 reach 1.8e9 (2026), milliseconds are beyond this limit."""
ECG_VALUE = 1e9
"""Largest ECG sample in any unit: converters of 24 bit count to 1.7e7, of 32 bit to 2.1e9 at most."""
RR_S = (0.2, 3.0)
"""Shortest and longest RR interval: 300 and 20 beats/min."""
CYCLE_SHARE = 0.4
"""Least share of the RR interval that the phases of a cine span: prospective gating covers 80 % or more."""
VOLUME_STEP_S = (0.002, 3.0)
"""Shortest and longest time from one 3-D ultrasound volume to the next: probes take 1 to 100 volumes/s."""
LABELS_MM = (5.0, 1e3)
"""Longest side of the box around labels: a newborn's chamber has 15 mm, a heart in m 0.1, in inches 4."""
VOXEL_MM = (0.02, 100.0)
"""Smallest and largest voxel side of a scanner: CT has 0.2 mm, ultrasound 0.05, slices at most 20 apart."""
SCANNER_MM = 1e4
"""Farthest point of an image: tables travel 2 m, trackers reach 5 m."""


def require_plausible(values: Any, most: float, what: str) -> None:
    """Refuse finite numbers beyond `most`; numbers that are not finite are checked elsewhere.

    Raises:
        InvalidInputError: a number is larger; the message states it.
    """
    array = np.abs(np.asarray(values, dtype=np.float64))
    if (beyond := array[np.isfinite(array) & (array > most)]).size:
        raise InvalidInputError(
            f"{what} reaches {float(beyond.max()):.3g}; needed at most {most:g}: check its unit and source"
        )
