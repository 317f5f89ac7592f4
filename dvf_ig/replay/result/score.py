"""Scores of estimates against the ground truth; unused for scenarios without one."""

import itertools
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    BoolArray,
    BreathingTruth,
    FloatArray,
    ImageMap,
    IntArray,
    ScenarioTruth,
    SurfaceSeries,
)

NEAR_WALL_MM = 5.0
"""Distance of the tool from the true wall within which violation depth is judged: distance errors are
local."""
CONTACT_MM = 0.0
"""Largest distance outside the true surface at which the tip is in contact."""

FAR_OFF_MM = 3.0
"""Error of the wall's place at the tool from which a force counts as far off."""
HAZARD_FORCE_N = 0.001
HAZARD_MM = 5.0
"""A tick is hazardous if it gives more than HAZARD_FORCE_N while guidance is more than HAZARD_MM off: the
pose, by its mean error over the targets; where a change of shape is followed, the wall's place at the tool,
since the pose then says little without the warp."""


@dataclass(frozen=True, slots=True)
class PhaseScore:
    """Phase error over valid ticks: in % of RR, and in mm of the moving surface."""

    percent_mean: float
    percent_p95: float
    surface_mm_mean: float
    surface_mm_p95: float


@dataclass(frozen=True, slots=True)
class ForceScore:
    """Force error over ticks in contact with valid state."""

    error_n_median: float
    error_n_p95: float


@dataclass(frozen=True, slots=True)
class SurfaceScore:
    """Error of the guarded wall's place at the tool, and the seconds of force on one FAR_OFF_MM off."""

    rms: float
    median: float
    p95: float
    force_far_off_s: float


@dataclass(frozen=True, slots=True)
class HazardScore:
    """Seconds of hazardous force: all of them, and the longest without a break."""

    total_s: float
    longest_s: float


def pose_errors_mm(mr_from_tracker: FloatArray, t_s: FloatArray, truth: ScenarioTruth) -> FloatArray:
    """Compute (n, k) TRE at the k declared targets at each tick; NaN if no pose was used.

    Args:
        mr_from_tracker: (n, 3, 4) rotation and translation used at each tick.
        t_s: (n,) tick times.
    """
    targets = truth.targets.points.xyz_mm
    if truth.breathing is not None:
        return _errors_of_the_moment(mr_from_tracker, t_s, truth, truth.breathing)
    errors = np.empty((len(t_s), len(targets)))
    begins = np.searchsorted(t_s, [start_s for start_s, _ in truth.mr_from_tracker])
    for (_, true_pose), (begin, end) in zip(
        truth.mr_from_tracker, itertools.pairwise([*begins, len(t_s)]), strict=True
    ):
        here = slice(0 if begin == begins[0] else int(begin), int(end))
        tracker = true_pose.inverse().apply_array(targets)
        used, run = _runs(mr_from_tracker[here])
        apart = np.einsum("nij,kj->nki", used[:, :, :3], tracker) + used[:, None, :, 3] - targets
        errors[here] = np.linalg.norm(apart, axis=2)[run]
    return errors


def _errors_of_the_moment(
    mr_from_tracker: FloatArray, t_s: FloatArray, truth: ScenarioTruth, breathing: BreathingTruth
) -> FloatArray:
    """Compute (n, k) TRE at the targets, which each tick finds where breathing has moved them."""
    targets = truth.targets.points.xyz_mm
    errors = np.empty((len(t_s), len(targets)))
    for begin in range(0, len(t_s), 4096):
        here = slice(begin, begin + 4096)
        moved, used = breathing.targets_at(t_s[here]), mr_from_tracker[here]
        poses = [truth.mr_from_tracker_at(t) for t in t_s[here].tolist()]
        turns, shifts = np.array([p.rotation for p in poses]), np.array([p.translation_mm for p in poses])
        tracker = np.einsum("nji,nkj->nki", turns, moved - shifts[:, None])
        apart = np.einsum("nij,nkj->nki", used[:, :, :3], tracker) + used[:, None, :, 3] - targets
        errors[here] = np.linalg.norm(apart, axis=2)
    return errors


def _runs(poses: FloatArray) -> tuple[FloatArray, IntArray]:
    """Find the first of each run of equal (n, 3, 4) poses, and (n,) the run of each tick."""
    same = (poses[1:] == poses[:-1]) | (np.isnan(poses[1:]) & np.isnan(poses[:-1]))
    begins = np.concatenate([[True], ~same.all(axis=(1, 2))])[: len(poses)]
    return poses[begins], np.cumsum(begins) - 1


def score_phase(
    phi: FloatArray,
    model_phase: FloatArray,
    true_phi: FloatArray,
    true_model_phase: FloatArray,
    surface: SurfaceSeries,
) -> PhaseScore:
    """Compare (n,) estimated phases with the true ones at the same ticks."""
    percent = 100 * np.abs((phi - true_phi + 0.5) % 1.0 - 0.5)
    moved = surface_displacement_mm(surface, model_phase, true_model_phase)
    return PhaseScore(
        float(percent.mean()),
        float(np.percentile(percent, 95)),
        float(moved.mean()),
        float(np.percentile(moved, 95)),
    )


def surface_displacement_mm(surface: SurfaceSeries, first: FloatArray, second: FloatArray) -> FloatArray:
    """Compute (n,) mean distances over the surface between its positions at two sets of model phases.

    Uses at most 200 vertices and 4000 ticks, both evenly spread.
    """
    vertices = surface.vertices_mm[:, :: max(1, surface.vertices_mm.shape[1] // 200)]
    ticks = slice(None, None, max(1, len(first) // 4000))
    apart = _interpolated(vertices, surface, first[ticks]) - _interpolated(vertices, surface, second[ticks])
    return np.asarray(np.linalg.norm(apart, axis=2).mean(axis=1))


def _interpolated(vertices: FloatArray, surface: SurfaceSeries, phase: FloatArray) -> FloatArray:
    fractions = surface.timing.fractions
    after = np.searchsorted(fractions, phase % 1.0, side="right")
    first, second = (after - 1) % len(fractions), after % len(fractions)
    width = (fractions[second] - fractions[first]) % 1.0
    weight = (((phase - fractions[first]) % 1.0) / width)[:, None, None]
    return np.asarray((1 - weight) * vertices[first] + weight * vertices[second])


def far_corner_error_mm(estimate: ImageMap, truth: ImageMap, rows: int, columns: int) -> float:
    """Compute the largest distance between two calibrations over the image's corners."""
    corners = np.array([[c, r] for c in (0, columns - 1) for r in (0, rows - 1)], dtype=np.float64)
    apart = estimate.apply_pixels(corners).xyz_mm - truth.apply_pixels(corners).xyz_mm
    return float(np.linalg.norm(apart, axis=1).max())


def score_force(
    force_n: FloatArray, valid: BoolArray, true_force_n: FloatArray, contact: BoolArray
) -> ForceScore | None:
    """Score the force error in contact with valid state.

    Args:
        force_n, true_force_n: (n, 3) in the tracker's frame.
        valid: (n,) state is valid and the supervisor follows the fixtures; contact: (n,).
    """
    with_force = contact & valid & (np.linalg.norm(force_n, axis=1) > 0)
    if not with_force.any():
        return None
    error = np.linalg.norm(force_n[with_force] - true_force_n[with_force], axis=1)
    return ForceScore(float(np.median(error)), float(np.percentile(error, 95)))


def score_surface(
    believed_mm: FloatArray, true_mm: FloatArray, with_force: BoolArray, tick_s: float
) -> SurfaceScore | None:
    """Score the place of the wall at the tool, along its normal; None if the tool was never near it.

    Args:
        believed_mm, true_mm: (n,) signed distance at each tick, NaN where none is believed.
        with_force: (n,) ticks in which a force was given.
    """
    off = np.abs(believed_mm - true_mm)
    near = np.isfinite(off) & (np.abs(true_mm) <= NEAR_WALL_MM)
    if not near.any():
        return None
    far_off = with_force & near & (off > FAR_OFF_MM)
    return SurfaceScore(
        float(np.sqrt(np.mean(off[near] ** 2))),
        float(np.median(off[near])),
        float(np.percentile(off[near], 95)),
        float(far_off.sum() * tick_s),
    )


def guidance_errors_mm(pose_mm: FloatArray, wall_mm: FloatArray, followed: BoolArray) -> FloatArray:
    """Compute (n,) errors by which a force is judged: of the pose, or of the wall it guards.

    Args:
        pose_mm: (n,) mean error of the pose over the targets; NaN without a pose.
        wall_mm: (n,) error of the wall's place at the tool; for NaN the last one counts.
        followed: (n,) ticks in which a change of shape is followed, so that the wall's error counts.
    """
    last = last_of(np.isfinite(wall_mm))
    return np.where(followed & (last >= 0), wall_mm[last], pose_mm)


def last_of(chosen: BoolArray) -> IntArray:
    """Find (n,) the last chosen index up to each, -1 before the first."""
    return np.asarray(np.maximum.accumulate(np.where(chosen, np.arange(len(chosen)), -1)))


def score_hazard(force_n: FloatArray, error_mm: FloatArray, tick_s: float) -> HazardScore:
    """Measure the time with a force while guidance was far off; see HAZARD_FORCE_N and HAZARD_MM.

    Args:
        force_n: (n, 3) force given at each tick; ticks are equally spaced.
        error_mm: (n,) how far guidance is off at each tick; NaN without any, which does not count.
        tick_s: time from one tick to the next.
    """
    hazard = (np.linalg.norm(force_n, axis=1) > HAZARD_FORCE_N) & (error_mm > HAZARD_MM)
    edges = np.flatnonzero(np.diff(hazard, prepend=False, append=False))
    lengths = edges[1::2] - edges[::2]
    return HazardScore(float(hazard.sum() * tick_s), float(lengths.max(initial=0) * tick_s))


def score_violation(true_mm: FloatArray, believed_mm: FloatArray) -> dict[str, float] | None:
    """Compute a wall's depth in the organ: the true depth at which its force reaches half of its cap.

    Args:
        true_mm: (n,) signed distance to the true surface at the tool, positive in the forbidden region.
        believed_mm: (n,) the distance that the fixture uses there, its margin included.
    """
    if len(true_mm) == 0:
        return None
    depth = np.maximum(true_mm - believed_mm, 0.0)
    return {"p95": float(np.percentile(depth, 95)), "max": float(depth.max())}
