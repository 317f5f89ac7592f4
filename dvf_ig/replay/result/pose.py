"""The pose over a replay: beats, drift, when and why it was withheld, and whether its stated bounds held."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, IntArray, Landmarks, Rigid, ScenarioTruth, SurfaceSeries, Warp
from dvf_ig.core.space.warp import RIGID_SIGMA_MM
from dvf_ig.guidance import Evaluator, Hazard, Sigmoid
from dvf_ig.kernels.warp import LARGEST_MM2
from dvf_ig.registration import PoseChart, target_errors_mm
from dvf_ig.replay.engine import Replay
from dvf_ig.replay.preconditions import RATE_HZ
from dvf_ig.replay.ticks import Ticks
from dvf_ig.session import PoseUpdate, SessionHistory
from dvf_ig.session.pose_states import MAX_AGE_S, MAX_BOUND_MM, MAX_MISSED_BEATS

from .score import pose_errors_mm

MIN_SPAN_S = 10.0
"""Shortest time over which drift is stated: over less it is within the scatter of single updates."""
VERTICES_APART = 40
"""Every so many vertices of the true surface are compared with the guarded walls."""


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


@dataclass(frozen=True, slots=True)
class WithheldSpan:
    """Time after the first pose in which none was used, so that no force was given.

    Attributes:
        begin_s, end_s: the last span may end with the recording.
        rule: the rule that acted, in a few words.
        why: what happened, as a sentence's part.
    """

    begin_s: float
    end_s: float
    rule: str
    why: str


def withheld_spans(replay: Replay) -> tuple[WithheldSpan, ...]:
    """List the times in which the pose was withheld, each with the rule that acted at its begin."""
    ticks, updates = replay.ticks, tuple(replay.history.updates)
    posed = _posed(ticks)
    withheld = np.maximum.accumulate(posed) & ~posed
    edges = np.flatnonzero(np.diff(withheld, prepend=False, append=False))
    ends_s = np.append(ticks.t_s, ticks.t_s[-1])
    return tuple(
        WithheldSpan(float(ends_s[begin]), float(ends_s[end]), *_rule(ticks, updates, int(begin)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    )


def _rule(ticks: Ticks, updates: Sequence[PoseUpdate], begin: int) -> tuple[str, str]:
    """Name the rule by which the pose is withheld from a tick on, and describe what happened."""
    last = next((u for u in reversed(updates) if u.from_s <= ticks.t_s[begin]), None)
    if last is not None and last.pose is None:
        return "contradicted", "pose contradicted" if last.doubt is None else last.doubt.sentence
    if ticks.hazards[begin] & Hazard.BREATHING:
        return "breathing", "the heart's place in the breath was not known"
    if ticks.pose_age_s[begin] >= MAX_AGE_S:
        return f"{MAX_AGE_S:g} s old", f"no heart beat confirmed the pose for {MAX_AGE_S:g} s"
    if ticks.pose_bound_mm[begin] >= MAX_BOUND_MM:
        return f"bound {MAX_BOUND_MM:g} mm", f"its 95 % bound reached {MAX_BOUND_MM:g} mm"
    return (
        f"{MAX_MISSED_BEATS} beats missed",
        f"{MAX_MISSED_BEATS} heart beats in a row did not confirm the pose",
    )


def _posed(ticks: Ticks) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Flag (n,) ticks with a pose."""
    return np.isfinite(ticks.mr_from_tracker[:, 0, 0])


def without_force_s(ticks: Ticks) -> float:
    """Sum the seconds from the first pose on in which the supervisor released or withheld the force."""
    return _seconds(ticks, np.maximum.accumulate(_posed(ticks)) & ~ticks.guided)


def _seconds(ticks: Ticks, chosen: np.ndarray[Any, np.dtype[np.bool_]]) -> float:
    lasts_s = np.diff(ticks.t_s, append=ticks.t_s[-1:] + 1.0 / RATE_HZ)
    return round(float(lasts_s[chosen].sum()), 6)


def update_fields(replay: Replay) -> dict[str, Any]:
    """Summarise the pose's updates by beats and registrations."""
    ticks = replay.ticks
    summary = summarise_poses(replay.history, replay.heart.center_mm, float(ticks.t_s[-1]))
    return {
        "tracked_beats": summary.tracked_beats,
        "drift_mm_per_min": summary.drift_mm_per_min,
        "update_seconds": None
        if summary.update_s_median is None
        else {"median": summary.update_s_median, "p95": summary.update_s_p95},
        "withheld_s": _seconds(ticks, np.maximum.accumulate(_posed(ticks)) & ~_posed(ticks)),
        "withheld": [asdict(span) for span in withheld_spans(replay)],
        "without_force_s": without_force_s(ticks),
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


def age_fields(ticks: Ticks) -> dict[str, float] | None:
    """Summarise the age of the pose (time since a beat confirmed it) over the ticks with a force."""
    age_s = ticks.pose_age_s[ticks.valid]
    return {"median": float(np.median(age_s)), "max": float(age_s.max())} if len(age_s) else None


def _stated_targets(replay: Replay, truth: ScenarioTruth) -> Landmarks:
    """Points over which bounds are stated: the targets, or the covered surface of a heart imaged in part."""
    covered = replay.heart.covered
    if covered is None:
        return truth.targets
    return Landmarks(tuple(str(k) for k in range(len(covered.surface))), covered.surface)


def bound_fields(replay: Replay) -> dict[str, float | None] | None:
    """Compute the median of the stated bounds, and the share of them that held at every target.

    Targets of a heart that its images cover in part are the points of its covered surface. None if none was
    stated; the share is None without a truth.
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
        targets = _stated_targets(replay, truth)
        within = [
            target_errors_mm(pose, truth.mr_from_tracker_at(t_s), targets.points).max() <= bound
            for t_s, pose, bound in stated
        ]
        coverage = float(np.mean(within))
    return {"median": float(np.median([bound for _, _, bound in stated])), "coverage": coverage}


def pose_bound_fields(replay: Replay) -> dict[str, float | None] | None:
    """Compute the median bound of the pose in use, and the share of pose updates at which it held.

    The bound is stated at each update of the pose, a registration's on the largest error (`bound_fields`).
    None without a pose; without a truth no share.
    """
    ticks = replay.ticks
    at = np.searchsorted(ticks.t_s, [u.from_s for u in replay.history.updates if u.pose is not None])
    at = at[at < len(ticks)]
    at = at[_posed(ticks)[at]]
    if not len(at):
        return None
    bounds, coverage = ticks.pose_bound_mm[at], None
    if replay.scenario.truth is not None:
        coverage = float(np.mean(bounded_rms_mm(replay, replay.scenario.truth, at) <= bounds))
    return {"median": float(np.median(bounds)), "coverage": coverage, "updates": len(at)}


def bounded_rms_mm(replay: Replay, truth: ScenarioTruth, at: IntArray) -> FloatArray:
    """Compute (k,) RMS errors at some ticks, each of what the pose's bound refers to.

    That is the heart or its covered surface, or the guarded walls of a heart whose shape is followed.

    Args:
        at: (k,) indices of ticks with a pose.
    """
    ticks, updates, model = replay.ticks, tuple(replay.history.updates), replay.setup.heart.model
    stated = truth
    if truth.breathing is None:
        stated = replace(truth, targets=_stated_targets(replay, truth))
    rms_mm = np.sqrt((pose_errors_mm(ticks.mr_from_tracker[at], ticks.t_s[at], stated) ** 2).mean(axis=1))
    in_force = updates_in_force(updates, ticks.t_s[at])
    for number in np.unique(in_force[in_force >= 0]).tolist():
        update = updates[number]
        if update.pose is not None and update.warp is not None:
            moved = update.pose @ truth.mr_from_tracker_at(update.from_s).inverse()
            rms_mm[in_force == number] = guarded_wall_rms_mm(model, truth.surface, moved, update.warp)
    return np.asarray(rms_mm)


def updates_in_force(updates: Sequence[PoseUpdate], t_s: FloatArray) -> IntArray:
    """Find (n,) which update gave the last pose at each time, -1 before the first."""
    posed = np.array([k for k, update in enumerate(updates) if update.pose is not None] or [-1])
    begins_s = [updates[k].from_s for k in posed.tolist() if k >= 0]
    return np.append(posed, -1)[np.searchsorted(begins_s, t_s, side="right") - 1]


def guarded_wall_rms_mm(model: DvfModel, surface: SurfaceSeries, moved: Rigid, warp: Warp) -> float:
    """Compute the RMS distance of the true surface from the walls where a force may be given.

    Where it may be given nowhere, from all walls.

    Args:
        surface: the patient's; moved: its estimated from its true position, model frame.
    """
    vertices = surface.vertices_mm[:, ::VERTICES_APART]
    phases = np.repeat(surface.timing.fractions, vertices.shape[1])
    off_mm, variance_mm2 = wall_errors_mm(model, moved.apply_array(vertices.reshape(-1, 3)), phases, warp)
    served = np.isfinite(off_mm) & (variance_mm2 <= LARGEST_MM2)
    return float(np.sqrt(np.nanmean(off_mm[served if served.any() else ...] ** 2)))


def wall_errors_mm(
    model: DvfModel, places_mm: FloatArray, phases: FloatArray, warp: Warp | None
) -> tuple[FloatArray, FloatArray]:
    """Compute (n,) distances of the guarded walls from places that truly lie on them, and (n,) variances.

    NaN where the model does not know its walls.

    Args:
        places_mm: (n, 3) where the registered pose puts them, model frame; phases: (n,).
        warp: change of shape that is followed; None: the heart is guarded as rigid.
    """
    variance_mm2, contraction = np.full(len(places_mm), RIGID_SIGMA_MM**2), 1.0
    if warp is not None:
        m_mm, variance_mm2 = warp.at(places_mm)
        places_mm, contraction = places_mm - m_mm, warp.contraction
    wall = Evaluator(model, Sigmoid(), contraction=contraction).force(places_mm, phases)
    return wall.distance_mm / np.linalg.norm(wall.gradient, axis=1), variance_mm2
