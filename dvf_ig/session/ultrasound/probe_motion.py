"""The probe's pose at the moment of an image, from the poses tracked around it.

A hand moves smoothly over half a second, a tracker's noise is new in every sample. So the pose is that of a
quadratic in time, fitted to POSES neighbouring samples (local regression, Cleveland 1979; rotations as
rotation vectors about the interpolated pose). Where the hand was quicker than that, which shows as a misfit
beyond the noise, the interpolated pose stands.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import BoolArray, FloatArray, PoseStream
from dvf_ig.core.recordings.stream import MAX_GAP_S

POSES = 13
"""One second at 12 Hz: a noise of 1 mm falls to 0.4 mm in the middle, a sweep of 40° in 9 s is bent by less
than 0.05 mm."""
DEGREE = 2
REACH_MM = 100.0
"""What turns rotation into mm: from the probe to the heart."""
MISFIT = 2.0
"""Residual variance over that of the noise, from third differences, above which the fit is not used."""


MEDIAN_OF_SQUARES = 0.455
"""Median over mean of the squares of Gaussian numbers."""


def smoothed_poses(stream: PoseStream, t_s: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Rotations (k, 3, 3), translations (k, 3) and validity (k,) at the given times.

    Validity is that of `PoseStream.at_many`, and so is the pose where fewer than POSES valid samples lie
    around it without a gap.
    """
    rotations, translations, valid = stream.at_many(t_s)
    known = np.flatnonzero(stream.valid)
    chosen, window = _windows(stream.t_s[known], t_s)
    chosen &= valid
    if not chosen.any():
        return rotations, translations, valid
    near = known[window[chosen]]
    base = Rotation.from_matrix(np.repeat(rotations[chosen], POSES, axis=0))
    turns = (base.inv() * Rotation.from_matrix(stream.rotations[near].reshape(-1, 3, 3))).as_rotvec()
    shifts = stream.translations_mm[near] - translations[chosen, None]
    moved = np.concatenate([REACH_MM * turns.reshape(shifts.shape), shifts], axis=2)
    at_once, fits = _local_fits(stream.t_s[near] - t_s[chosen, None], moved)
    place = np.flatnonzero(chosen)[fits]
    step = at_once[fits]
    turned = Rotation.from_matrix(rotations[place]) * Rotation.from_rotvec(step[:, :3] / REACH_MM)
    rotations[place] = turned.as_matrix()
    translations[place] += step[:, 3:]
    return rotations, translations, valid


def _windows(known_s: FloatArray, t_s: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Which times have POSES samples around them without a gap, and (k, POSES) their indices."""
    count = len(known_s)
    if count < POSES:
        return np.zeros(len(t_s), dtype=np.bool_), np.zeros((len(t_s), POSES), dtype=np.int64)
    stretch = np.concatenate([[0], np.cumsum(np.diff(known_s) > MAX_GAP_S)])
    right = np.clip(np.searchsorted(known_s, t_s), 0, count - 1)
    first = np.searchsorted(stretch, stretch[right])
    last = np.searchsorted(stretch, stretch[right], side="right")
    begin = np.clip(right - POSES // 2, first, np.maximum(last - POSES, first))
    enough = last - first >= POSES
    return enough, np.where(enough, begin, 0)[:, None] + np.arange(POSES)


def _local_fits(x: FloatArray, y: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(k, 6) value at 0 of a polynomial through (k, n, 6) values at (k, n), and whether it fits them."""
    reach = 1.1 * np.abs(x).max(axis=1, keepdims=True)
    powers = (x / reach)[:, :, None] ** np.arange(DEGREE + 1)
    near = ((1.0 - np.abs(x / reach) ** 3) ** 3)[:, :, None]
    weighted, plain = (np.swapaxes(powers, 1, 2) @ (w * powers) for w in (near, 1.0))
    at_once = np.linalg.solve(weighted, np.swapaxes(powers, 1, 2) @ (near * y))[:, 0]
    left = y - powers @ np.linalg.solve(plain, np.swapaxes(powers, 1, 2) @ y)
    residual = np.square(left).sum(axis=(1, 2)) / (6 * (POSES - DEGREE - 1))
    # the variance of white noise is 1/20 of that of its third differences; their median passes over a jump
    noise = np.median(np.square(np.diff(y, 3, axis=1)), axis=1).mean(axis=1) / 20.0 / MEDIAN_OF_SQUARES
    return at_once, residual <= MISFIT * noise
