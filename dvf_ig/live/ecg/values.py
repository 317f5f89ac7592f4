"""Check of ECG values."""

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.core.plausible import ECG_VALUE


def plausible(values: FloatArray) -> FloatArray:
    """Replace values that are not finite or beyond ECG_VALUE by NaN, a missing sample."""
    return np.where(np.abs(values) <= ECG_VALUE, values, np.nan)
