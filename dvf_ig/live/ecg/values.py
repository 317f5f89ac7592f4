"""Values that an ECG can have."""

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.core.plausible import ECG_VALUE


def plausible(values: FloatArray) -> FloatArray:
    """Put NaN, a missing sample, in place of what is not finite or beyond ECG_VALUE."""
    return np.where(np.abs(values) <= ECG_VALUE, values, np.nan)
