"""Summary of the pose over a replay: beats evaluated, drift, suspensions and computing time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration import PoseChart
from dvf_ig.session import PoseUpdate, SessionHistory

MIN_SPAN_S = 10.0
"""Shortest time over which drift is stated: over less it is within the scatter of single updates."""


@dataclass(frozen=True, slots=True)
class PoseSummary:
    """Numbers that summarise the pose over a replay.

    Attributes:
        tracked_beats: beats that were compared with the pose then in use.
        drift_mm_per_min: speed of the pose since the last suspension, mean over the heart; None if that time
            is short.
        update_s_median, update_s_p95: computing time of a beat's update, preparation included; None without
            any.
        suspended_s: begin and end of each suspension; the last may end with the recording.
    """

    tracked_beats: int
    drift_mm_per_min: float | None
    update_s_median: float | None
    update_s_p95: float | None
    suspended_s: tuple[tuple[float, float], ...]


def summarise_poses(history: SessionHistory, center_mm: FloatArray, end_s: float) -> PoseSummary:
    """Summarise beats, drift, computing time and suspensions of a whole replay.

    Args:
        center_mm: (3,) centre of the heart box; end_s: end of the recording.
    """
    seconds, updates = [beat.seconds for beat in history.beats], tuple(history.updates)
    return PoseSummary(
        sum(beat.in_use for beat in history.beats),
        drift_mm_per_min(updates, center_mm),
        float(np.median(seconds)) if seconds else None,
        float(np.percentile(seconds, 95)) if seconds else None,
        suspensions(updates, end_s),
    )


def suspensions(updates: Sequence[PoseUpdate], end_s: float) -> tuple[tuple[float, float], ...]:
    """List begin and end of each suspension of the pose."""
    spans: list[tuple[float, float]] = []
    for i, update in enumerate(updates):
        if update.pose is None:
            spans.append((update.from_s, updates[i + 1].from_s if i + 1 < len(updates) else end_s))
    return tuple(spans)


def drift_mm_per_min(updates: Sequence[PoseUpdate], center_mm: FloatArray) -> float | None:
    """Fit the slope of the poses since the last suspension, mean over the heart, by least squares."""
    since: list[tuple[float, Rigid]] = []
    for update in updates:
        if update.pose is None:
            since = []
        else:
            since.append((update.from_s, update.pose))
    if len(since) < 3 or since[-1][0] - since[0][0] < MIN_SPAN_S:
        return None
    chart = PoseChart(since[0][1], center_mm)
    times = np.array([from_s for from_s, _ in since])
    coordinates = np.array([chart.coordinates(pose) for _, pose in since])
    slope = np.polyfit(times - times.mean(), coordinates, 1)[0]
    points = np.vstack([np.eye(3), -np.eye(3)])
    moved = np.cross(slope[:3], points) + slope[3:]
    return float(60.0 * np.linalg.norm(moved, axis=1).mean())
