"""What is known beforehand of how a heart differs in shape from its pre-operative images.

The difference is a Gaussian process: alike over LENGTH_MM, RMS_MM on average, of every direction, and without
a rigid part over the heart, since that is the pose. It is this last condition that tells pose and change of
shape apart where ultrasound sees a part of the heart only (Rasmussen and Williams 2006, ch. 2; processes
conditioned on linear functionals).
"""

import numpy as np
from scipy.linalg.lapack import dpstrf

from dvf_ig.core import HEART_RADIUS_MM, FloatArray
from dvf_ig.registration.pose_chart import rigid_motion

LENGTH_MM, RMS_MM = 45.0, 1.5
"""Tracked sweeps of tuning hearts 1001–1008, calm, 1.2 mm different over 30 mm: on average 1.68 mm off
without a change of shape; 1.41 with 30 mm and 2.5 mm; 1.40, 1.37 and 1.35 with 45 mm and 1.5, 2 and 2.5 mm.
Gated volumes of seeds 101–105, where all of the heart is seen: 0.81 without, 0.83 with 2.5 mm."""
NODES = 5
"""Along an edge of the cube over which the change of shape has no rigid part."""
LEAST_VARIANCE = 1e-3
"""What of a coordinate's variance may be left out, as a share of it."""


def deformation_factor(places_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(n, 3, k) F: the change of shape at (n, 3) places is F z with z of independent standard normals.

    Args:
        center_mm: (3,) of the heart, a cube of twice HEART_RADIUS_MM about which has no rigid part.
    """
    edge = np.linspace(-HEART_RADIUS_MM, HEART_RADIUS_MM, NODES)
    nodes = center_mm + np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
    everywhere = np.concatenate([places_mm, nodes])
    of_each_axis = np.sqrt(RMS_MM**2 / 3.0) * _cholesky(_alike(everywhere, everywhere))
    of_places, of_nodes = np.split(of_each_axis, [len(places_mm)])
    fit = np.linalg.pinv(rigid_motion(nodes, center_mm).reshape(-1, 6)).reshape(6, -1, 3)
    rigid_part = np.tensordot(
        rigid_motion(places_mm, center_mm), np.tensordot(fit, of_nodes, axes=(1, 0)), axes=1
    )
    field = of_places[:, None, None, :] * np.eye(3)[None, :, :, None]
    return np.asarray((field - rigid_part).reshape(len(places_mm), 3, -1))


def _cholesky(covariance: FloatArray) -> FloatArray:
    """(n, k) L with L Lᵀ the covariance but for LEAST_VARIANCE: pivoted, stopped early (LAPACK dpstrf)."""
    lower, pivots, rank, _ = dpstrf(covariance, tol=LEAST_VARIANCE, lower=1)
    factor = np.empty((len(covariance), rank))
    factor[pivots - 1] = np.tril(lower)[:, :rank]
    return factor


def _alike(a_mm: FloatArray, b_mm: FloatArray) -> FloatArray:
    """(n, m) correlation between (n, 3) and (m, 3) places."""
    apart = ((a_mm[:, None] - b_mm[None]) ** 2).sum(axis=-1)
    return np.asarray(np.exp(-0.5 * apart / LENGTH_MM**2))
