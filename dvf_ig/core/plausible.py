"""The largest numbers that an operating room has: beyond them a unit is wrong, or data are damaged."""

from typing import Any

import numpy as np

from .errors import InvalidInputError

LENGTH_MM = 1e6
"""No coordinate in an operating room lies a kilometre from the origin; trackers reach 5 m, scanners 2 m."""
TIME_S = 1e10
"""Time stamps: seconds since 1970 reach 1.8e9 (2026); milliseconds since then are beyond this limit."""
ECG_VALUE = 1e9
"""An ECG's samples in any unit: converters of 24 bit count to 1.7e7, of 32 bit to 2.1e9 at most."""


def require_plausible(values: Any, most: float, what: str) -> None:
    """Refuse finite numbers beyond `most`; numbers that are not finite are judged elsewhere.

    Raises:
        InvalidInputError: says which and how large.
    """
    array = np.abs(np.asarray(values, dtype=np.float64))
    if (beyond := array[np.isfinite(array) & (array > most)]).size:
        raise InvalidInputError(
            f"{what} reaches {float(beyond.max()):.3g}; needed at most {most:g}: check its unit and source"
        )
