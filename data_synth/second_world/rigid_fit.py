"""Best rigid map between corresponding points, for the truth."""

import numpy as np

from dvf_ig.core import FloatArray, Rigid


def best_rigid(
    source_mm: FloatArray, target_mm: FloatArray, target: str, source: str, weights: FloatArray | None = None
) -> Rigid:
    """Fit target_from_source to (n, 3) points by least squares.

    Source: Kabsch, Acta Cryst. A32:922, 1976.
    """
    w = np.ones(len(source_mm)) if weights is None else weights
    a, b = np.average(source_mm, axis=0, weights=w), np.average(target_mm, axis=0, weights=w)
    u, _, vt = np.linalg.svd(((source_mm - a) * w[:, None]).T @ (target_mm - b))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u @ flip @ vt).T
    return Rigid(target, source, rotation, b - rotation @ a)
