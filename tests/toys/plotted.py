"""What a figure shows, as arrays."""

from typing import Any

import numpy as np

from dvf_ig.core import AnyArray


def xdata(line: Any) -> AnyArray:
    return np.asarray(line.get_xdata())


def ydata(line: Any) -> AnyArray:
    return np.asarray(line.get_ydata())


def axes_of(figure: Any) -> list[Any]:
    return list(figure.axes)
