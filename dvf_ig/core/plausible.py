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

ECG_RATE_HZ = (20.0, 50_000.0)
"""Slowest and fastest sampling of an ECG: long-term recorders keep 100 Hz, laboratories record 40 kHz."""
ECG_SWING_MV = (0.01, 100.0)
"""Smallest and largest swing of an ECG from beat to beat: a chest lead has 0.3 to 10 mV, one from inside the
heart 40 mV; a wrong unit is off by 1000."""


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
