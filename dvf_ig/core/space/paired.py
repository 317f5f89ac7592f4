"""Rigid fit of two sets of paired points."""

import numpy as np

from dvf_ig.core.arrays import FloatArray, frozen_floats
from dvf_ig.core.errors import InvalidInputError

from .points import Points
from .rigid import Rigid, nearest_rotation

COLLINEAR_RATIO = 1e-2
"""Second over first singular value of the centred points below which they count as a line."""


def fit_paired_points(target: Points, source: Points, weights: FloatArray | None = None) -> Rigid:
    """Fit target_from_source by minimising Σ wᵢ |target_i − T source_i|².

    Args:
        target, source: (n, 3) mm each, same order; n >= 3, not on one line.
        weights: (n,) non-negative; equal if omitted.
    Raises:
        InvalidInputError: different counts, fewer than 3 pairs (of positive weight), or points on one line.
    Source: Arun 1987, eqs 11–13; reflection fix per Umeyama 1991.
    """
    if len(target) != len(source):
        raise InvalidInputError(
            f"{len(target)} points in '{target.frame}' for {len(source)} in '{source.frame}'; "
            "paired points need equal counts in the same order"
        )
    w = np.ones(len(source)) if weights is None else frozen_floats(weights, "weights", (len(source),))
    if (w < 0).any() or np.count_nonzero(w) < 3:
        raise InvalidInputError(
            f"{np.count_nonzero(w > 0)} point pairs to fit {target.frame}_from_{source.frame}; "
            "needed at least 3 with positive weight and none negative"
        )
    w = w / w.sum()
    target_mean, source_mean = w @ target.xyz_mm, w @ source.xyz_mm
    moved, fixed = source.xyz_mm - source_mean, target.xyz_mm - target_mean
    for centred, frame in ((fixed, target.frame), (moved, source.frame)):
        _refuse_line(centred * np.sqrt(w)[:, None], frame)
    rotation = nearest_rotation((fixed * w[:, None]).T @ moved)
    return Rigid(target.frame, source.frame, rotation, target_mean - rotation @ source_mean)


def _refuse_line(centred_mm: FloatArray, frame: str) -> None:
    spread = np.linalg.svd(centred_mm, compute_uv=False)
    if spread[1] <= COLLINEAR_RATIO * spread[0]:
        raise InvalidInputError(
            f"the points in '{frame}' lie on one line (spread {spread[0]:.3g} mm along it, {spread[1]:.3g} "
            "mm across); add a point away from the line"
        )
