"""Pose fields of `result.json`: its updates, its age, and the bounds that registrations stated."""

from itertools import groupby
from typing import Any

import numpy as np

from dvf_ig.registration import target_errors_mm
from dvf_ig.replay.engine import Replay
from dvf_ig.replay.preconditions import RATE_HZ
from dvf_ig.replay.ticks import Ticks

from .pose_summary import summarise_poses


def update_fields(replay: Replay) -> dict[str, Any]:
    """Summarise the pose's updates by beats and registrations."""
    t_s = replay.ticks.t_s
    summary = summarise_poses(replay.history, replay.heart.center_mm, float(t_s[-1]))
    return {
        "tracked_beats": summary.tracked_beats,
        "drift_mm_per_min": summary.drift_mm_per_min,
        "update_seconds": None
        if summary.update_s_median is None
        else {"median": summary.update_s_median, "p95": summary.update_s_p95},
        "withheld_s": _withheld_s(replay.ticks),
        "doubts_s": [list(span) for span in summary.suspended_s],
    }


def tip_field(replay: Replay) -> dict[str, float] | None:
    """Describe where ultrasound last showed the tool's tip, and in how many beats; None if never."""
    sightings = replay.history.sightings
    if not sightings:
        return None
    last = sightings[-1]
    rows = [len(list(row)) for elsewhere, row in groupby(seen.elsewhere for seen in sightings) if elsewhere]
    return {
        "off_mm": last.off_mm,
        "beside_mm": last.beside_mm,
        "contrast_grey": last.contrast_grey,
        "ratio": last.ratio,
        "seen_beats": len(sightings),
        "elsewhere_beats": max(rows, default=0),
    }


def _withheld_s(ticks: Ticks) -> float:
    """Count the seconds after the first pose without a usable one: suspended, or unconfirmed."""
    posed = np.isfinite(ticks.mr_from_tracker[:, 0, 0])
    lasts_s = np.diff(ticks.t_s, append=ticks.t_s[-1:] + 1.0 / RATE_HZ)
    return round(float(lasts_s[np.maximum.accumulate(posed) & ~posed].sum()), 6)


def age_fields(ticks: Ticks) -> dict[str, float] | None:
    """Summarise the age of the pose (time since a beat confirmed it) over the ticks with a force."""
    age_s = ticks.pose_age_s[ticks.valid]
    return {"median": float(np.median(age_s)), "max": float(age_s.max())} if len(age_s) else None


def bound_fields(replay: Replay) -> dict[str, float | None] | None:
    """Compute the median of the stated bounds, and the share of them that held at every target.

    None if none was stated; the share is None without a truth.
    """
    stated = [
        (a.ready_s, a.result.target_from_source, a.result.tre_bound_mm)
        for a in replay.attempts
        if a.result is not None and a.result.tre_bound_mm is not None
    ]
    if not stated:
        return None
    truth, coverage = replay.scenario.truth, None
    if truth is not None:
        targets = truth.targets.points
        within = [
            target_errors_mm(pose, truth.mr_from_tracker_at(t_s), targets).max() <= bound
            for t_s, pose, bound in stated
        ]
        coverage = float(np.mean(within))
    return {"median": float(np.median([bound for _, _, bound in stated])), "coverage": coverage}
