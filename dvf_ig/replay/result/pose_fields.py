"""What `result.json` says of the pose: its updates, its age, and the bounds that registrations stated."""

from itertools import groupby
from typing import Any

import numpy as np

from dvf_ig.registration import target_errors_mm
from dvf_ig.replay.engine import Replay
from dvf_ig.replay.preconditions import RATE_HZ
from dvf_ig.replay.ticks import Ticks

from .pose_summary import summarise_poses


def update_fields(replay: Replay) -> dict[str, Any]:
    """What beats and registrations did to the pose."""
    t_s = replay.ticks.t_s
    done = summarise_poses(replay.history, replay.heart.center_mm, float(t_s[-1]))
    return {
        "tracked_beats": done.tracked_beats,
        "drift_mm_per_min": done.drift_mm_per_min,
        "update_seconds": None
        if done.update_s_median is None
        else {"median": done.update_s_median, "p95": done.update_s_p95},
        "withheld_s": _withheld_s(replay.ticks),
        "doubts_s": [list(span) for span in done.suspended_s],
    }


def tip_field(replay: Replay) -> dict[str, float] | None:
    """Where ultrasound last showed the tool's tip, and in how many beats; None where it never did."""
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
    """Seconds after the first pose in which none could be used: suspended, or confirmed by no beat."""
    posed = np.isfinite(ticks.mr_from_tracker[:, 0, 0])
    lasts_s = np.diff(ticks.t_s, append=ticks.t_s[-1:] + 1.0 / RATE_HZ)
    return round(float(lasts_s[np.maximum.accumulate(posed) & ~posed].sum()), 6)


def age_fields(ticks: Ticks) -> dict[str, float] | None:
    """Age of the pose over the ticks that gave a force: time since a beat confirmed it."""
    age_s = ticks.pose_age_s[ticks.valid]
    return {"median": float(np.median(age_s)), "max": float(age_s.max())} if len(age_s) else None


def bound_fields(replay: Replay) -> dict[str, float | None] | None:
    """Median of the bounds that registrations stated, and the share of them that held at every target.

    None where none was stated; the share is None without a truth.
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
        held = [
            target_errors_mm(pose, truth.mr_from_tracker_at(t_s), targets).max() <= bound
            for t_s, pose, bound in stated
        ]
        coverage = float(np.mean(held))
    return {"median": float(np.median([bound for _, _, bound in stated])), "coverage": coverage}
