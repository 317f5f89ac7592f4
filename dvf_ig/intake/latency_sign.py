"""Whether images change with the probe's motion at the given latency, or at that of the other sign.

Images change more the faster the probe moves. With u(l) how far it moved points of the image between two
frames if the latency is l, log change is fitted as in `ecg_delay`, without the heart. With n/2 independent
pairs and the squared residual S(l), n/4·log(S(l)/S(−l)) is the log-likelihood ratio of the other sign. A
probe that rests or moves evenly says nothing: the ratio is near 0.
"""

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, ImageMap, PoseStream

from .ecg_delay import LEAST_PAIRS, ImageChange, grid_mm, moved_between_mm, residual_of_fit, without_heart

LEAST_LAG_S = 0.02
"""Latency below which its sign hardly matters: a probe at 30 mm/s moves by 1.2 mm in twice this time."""
REVERSED_LOG_RATIO = 3.0
"""Log-likelihood ratio of the other sign from which it is named; right ones of 25 to 70 ms have −5 to −14."""


def reversed_log_ratio(
    images: ImageChange, probe: PoseStream, image: ImageMap, shape: tuple[int, ...], lag_s: float
) -> float:
    """Log-likelihood ratio of −lag_s against lag_s by the probe's motion; 0 if it cannot be judged.

    Args:
        probe: tracker_from_probe.
        image: probe_from_image.
        shape: (rows, columns).
        lag_s: t_tracker = t_video + lag_s.
    """
    if abs(lag_s) < LEAST_LAG_S or not len(images.t_s):
        return 0.0
    points_mm = grid_mm(image, shape)
    moved_mm, seen = _moved_mm(images, probe, points_mm, lag_s)
    other, seen_other = _moved_mm(images, probe, points_mm, -lag_s)
    inside = seen & seen_other
    if (count := int(np.count_nonzero(inside))) < LEAST_PAIRS:
        return 0.0
    change = np.log(images.change[inside])
    left = [residual_of_fit(without_heart(moved[inside]), change)[0] for moved in (moved_mm, other)]
    return float(0.25 * count * np.log(left[0] / left[1]))


def _moved_mm(
    images: ImageChange, probe: PoseStream, points_mm: FloatArray, lag_s: float
) -> tuple[FloatArray, BoolArray]:
    """(n,) mean distance by which the probe moved points between two frames, and whether it was tracked."""
    ends = [probe.at_many(images.t_s + lag_s + part * images.step_s) for part in (-0.5, 0.5)]
    (turns, shifts_mm, seen), (turns_after, shifts_after_mm, seen_after) = ends
    return moved_between_mm(turns_after - turns, shifts_after_mm - shifts_mm, points_mm), seen & seen_after
