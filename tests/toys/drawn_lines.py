"""Coordinates of a line that was drawn, as arrays."""

import numpy as np
from matplotlib.lines import Line2D

from dvf_ig.core import FloatArray


def x_of(line: Line2D) -> FloatArray:
    """(n,) along the horizontal axis."""
    return np.asarray(line.get_xdata(), dtype=np.float64)


def y_of(line: Line2D) -> FloatArray:
    """(n,) along the vertical axis."""
    return np.asarray(line.get_ydata(), dtype=np.float64)
