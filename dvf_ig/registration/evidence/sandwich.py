"""Covariance of a pose fused from LC2 and the boundary, from how blocks of space and slices pull it.

With ψ_b the first-order influence of block b on the pose, (1 − s) H⁻¹g_b of LC2 and s M⁻¹r_b of the boundary
taken together, the pose varies by

    Σ_cell ψψᵀ + Σ_slice ψψᵀ − Σ_(cell ∩ slice) ψψᵀ

whatever the noise within a block is like: blocks of BLOCK_MM share the difference of patient and
pre-operative images, slices share the error of the tracker (Cameron, Gelbach and Miller 2011: clusters two
ways).
"""

import numpy as np

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.registration.lc2.blocks import BlockGradients

BLOCK_MM = 30.0
"""Edge of a block of space: mismatch of patient and images is correlated over some centimetres."""


def lc2_influence(blocks: BlockGradients, information: float, curvature: FloatArray) -> FloatArray:
    """(b, 6) influence of each block on LC2's pose, in the coordinates of `PoseChart`.

    Args:
        information: number of observations in −n/2·log(1 − S).
        curvature: (6, 6) of −log posterior at the pose.
    """
    total = max(float(blocks.cost.sum()), 1e-12)
    # the blocks are of coarse slices, whose optimum is not quite that of the fine ones
    own = blocks.gradient - np.outer(blocks.cost / total, blocks.gradient.sum(axis=0))
    return np.asarray(-0.5 * information / total * np.linalg.solve(curvature, own.T).T)


def sandwich(influence: FloatArray, cell: IntArray, number: IntArray) -> FloatArray:
    """(6, 6) two-way clustered covariance of Σ ψ.

    Args:
        influence: (b, 6) ψ of each block of each slice.
        cell: (b, 3) block of space; number: (b,) of the slice, −1 of what belongs to no slice.
    """
    both = np.column_stack([cell, number])
    total = _clustered(influence, cell) - _clustered(influence, both)
    total = total + _clustered(influence, number[:, None])
    values, vectors = np.linalg.eigh(0.5 * (total + total.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _clustered(influence: FloatArray, key: IntArray) -> FloatArray:
    """(6, 6) Σ over clusters of ψψᵀ, with the usual correction for few of them."""
    _, group = np.unique(key, axis=0, return_inverse=True)
    count = int(group.max()) + 1
    sums = np.zeros((count, influence.shape[1]))
    np.add.at(sums, group.ravel(), influence)
    return np.asarray(count / max(count - 1, 1) * sums.T @ sums)


def blended_influence(
    lc2: FloatArray,
    cell: IntArray,
    number: IntArray,
    boundary: FloatArray,
    boundary_cell: IntArray,
    share: float,
) -> tuple[FloatArray, IntArray, IntArray]:
    """Influences on a pose that went a share of the way from LC2's to the boundary's, cells and slices.

    Points of the boundary belong to no slice of their own: slice −1.
    """
    return (
        np.vstack([(1.0 - share) * lc2, share * boundary]),
        np.vstack([cell, boundary_cell]),
        np.concatenate([number, np.full(len(boundary), -1, dtype=np.int64)]),
    )
