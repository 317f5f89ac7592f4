"""Scatter of a pose from how blocks of space and slices pull it.

With ψ_b the first-order influence of block b on the pose, it varies by

    Σ_cell ψψᵀ + Σ_slice ψψᵀ − Σ_(cell ∩ slice) ψψᵀ

whatever the noise within a block is like: blocks of space share the difference of patient and pre-operative
images, slices share the error of the tracker (Cameron, Gelbach and Miller 2011: clusters two ways).
"""

import numpy as np

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.registration.deformation.joint_fit import none_negative
from dvf_ig.registration.distinct_rows import distinct_rows


def sandwich(influence: FloatArray, cell: IntArray, number: IntArray) -> FloatArray:
    """(6, 6) two-way clustered covariance of Σ ψ.

    Args:
        influence: (b, 6) ψ of each block of each slice.
        cell: (b, 3) block of space; number: (b,) of the slice, −1 of what belongs to no slice.
    """
    both = np.column_stack([cell, number])
    total = _clustered(influence, cell) - _clustered(influence, both)
    total = total + _clustered(influence, number[:, None])
    return np.asarray(none_negative(total[None])[0])


def _clustered(influence: FloatArray, key: IntArray) -> FloatArray:
    """(6, 6) Σ over clusters of ψψᵀ, with the usual correction for few of them."""
    _, group = distinct_rows(key)
    count = int(group.max()) + 1
    sums = np.zeros((count, influence.shape[1]))
    np.add.at(sums, group, influence)
    return np.asarray(count / max(count - 1, 1) * sums.T @ sums)
