"""What following the heart beat by beat amounted to: drift, doubt and effort."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration import PoseChart

from .beat_evaluation import Beat

LEAST_SPAN_S = 10.0
"""Drift over less than this is within what a beat's update wanders."""

Updates = Sequence[tuple[float, Rigid | None]]


@dataclass(frozen=True, slots=True)
class Following:
    """Attributes:
    tracked_beats: beats that were asked about the pose then guiding.
    drift_mm_per_min: speed of the pose since the last doubt, mean over the heart; None where that is short.
    update_s_median, update_s_p95: computing time of a beat's update, preparation included; None without any.
    doubts_s: begin and end of each time in doubt; the last may end with the recording.
    """

    tracked_beats: int
    drift_mm_per_min: float | None
    update_s_median: float | None
    update_s_p95: float | None
    doubts_s: tuple[tuple[float, float], ...]

    @property
    def withheld_s(self) -> float:
        return sum(end_s - begin_s for begin_s, end_s in self.doubts_s)


def summarise_following(
    beats: Sequence[Beat], updates: Updates, center_mm: FloatArray, end_s: float
) -> Following:
    """Args:
    updates: see `follow.Course`; end_s: of the recording.
    """
    seconds = [beat.seconds for beat in beats]
    return Following(
        sum(beat.guided for beat in beats),
        drift_mm_per_min(updates, center_mm),
        float(np.median(seconds)) if seconds else None,
        float(np.percentile(seconds, 95)) if seconds else None,
        doubts(updates, end_s),
    )


def doubts(updates: Updates, end_s: float) -> tuple[tuple[float, float], ...]:
    """Begin and end of each time in which a pose was withheld."""
    found: list[tuple[float, float]] = []
    for i, (from_s, pose) in enumerate(updates):
        if pose is None:
            found.append((from_s, updates[i + 1][0] if i + 1 < len(updates) else end_s))
    return tuple(found)


def drift_mm_per_min(updates: Updates, center_mm: FloatArray) -> float | None:
    """Least-squares slope of the poses since the last doubt, mean over the heart."""
    stretch: list[tuple[float, Rigid]] = []
    for from_s, pose in updates:
        if pose is None:
            stretch = []
        else:
            stretch.append((from_s, pose))
    if len(stretch) < 3 or stretch[-1][0] - stretch[0][0] < LEAST_SPAN_S:
        return None
    chart = PoseChart(stretch[0][1], center_mm)
    times = np.array([from_s for from_s, _ in stretch])
    places = np.array([chart.coordinates(pose) for _, pose in stretch])
    slope = np.polyfit(times - times.mean(), places, 1)[0]
    arms = np.vstack([np.eye(3), -np.eye(3)])
    moved = np.cross(slope[:3], arms) + slope[3:]
    return float(60.0 * np.linalg.norm(moved, axis=1).mean())
