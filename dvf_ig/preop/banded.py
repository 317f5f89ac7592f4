"""Banded matrices along the axes of an array, as values."""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, read_only_arrays
from dvf_ig.kernels.grid.separable import multiply_axis, multiply_axis_transposed


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BandedRows:
    """Matrix each of whose rows is one short window of weights.

    Attributes:
        first: (r,) column at which the window of each row begins.
        weights: (r, k) the window.
        columns: number of columns of the matrix.
    """

    first: IntArray
    weights: FloatArray
    columns: int

    def along(self, axis: int, values: FloatArray) -> FloatArray:
        """Compute A v along one axis of (…, columns, …); the axis gets as many entries as A has rows."""
        flat, shape = by_axis(values, axis)
        out = np.empty((flat.shape[0], len(self.first), flat.shape[2]))
        multiply_axis(self.first.copy(), self.weights.copy(), flat, out)
        return out.reshape(*shape[:axis], len(self.first), *shape[axis + 1 :])

    def transposed_along(self, axis: int, values: FloatArray) -> FloatArray:
        """Compute Aᵀ v along one axis of (…, rows, …)."""
        flat, shape = by_axis(values, axis)
        out = np.empty((flat.shape[0], self.columns, flat.shape[2]))
        multiply_axis_transposed(self.first.copy(), self.weights.copy(), flat, out)
        return out.reshape(*shape[:axis], self.columns, *shape[axis + 1 :])

    def dense(self) -> FloatArray:
        """(r, columns)."""
        out = np.zeros((len(self.first), self.columns))
        columns = self.first[:, None] + np.arange(self.weights.shape[1])
        np.add.at(out, (np.arange(len(out))[:, None], columns), self.weights)
        return out


def by_axis(values: FloatArray, axis: int) -> tuple[FloatArray, tuple[int, ...]]:
    """Reshape a contiguous, writable array to (before, along, after) about one axis; return its shape too."""
    shape = values.shape
    owned = values.flags.c_contiguous and values.flags.writeable and values.dtype == np.float64
    flat = values if owned else np.array(values, dtype=np.float64, order="C")
    before, after = math.prod(shape[:axis]), math.prod(shape[axis + 1 :])
    return flat.reshape(before, shape[axis], after), shape
