"""Errors in `result.json` against the ground truth: of poses, phase, force and the margin."""

from dataclasses import asdict
from typing import Any

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, Rigid, ScenarioTruth, summarise_errors
from dvf_ig.guidance import Confinement, Fixtures, Gaussian, Status, force_at_distance
from dvf_ig.registration import target_errors_mm
from dvf_ig.replay.engine import Replay
from dvf_ig.replay.preconditions import RATE_HZ

from .labels import label_fields
from .pose import updates_in_force
from .score import (
    CONTACT_MM,
    NEAR_WALL_MM,
    far_corner_error_mm,
    guidance_errors_mm,
    last_of,
    pose_errors_mm,
    score_force,
    score_hazard,
    score_phase,
    score_surface,
    score_violation,
)

ERROR_FIELDS = (
    "tre_mm",
    "start_tre_mm",
    "phase_error_percent_rr",
    "model_phase_error_mm",
    "force_error_n",
    "contact",
    "surface_error_mm",
    "lag_error_s",
    "probe_error_mm",
    "tip_error_mm",
    "label_dice",
    "hazard_s",
    "hazard_longest_s",
)
"""Fields that are None without a truth, or without a tick to which the error applies."""


def error_fields(replay: Replay) -> dict[str, Any]:
    """Compute those of ERROR_FIELDS that are known; none without a truth."""
    truth = replay.scenario.truth
    if truth is None:
        return {}
    ticks, track, valid = replay.ticks, replay.ticks.phase, replay.ticks.valid
    start_errors = target_errors_mm(replay.start, truth.mr_from_tracker_at(0.0), truth.targets.points)
    out: dict[str, Any] = {
        "start_tre_mm": summarise_errors(start_errors).tre_fields(),
        "label_dice": label_fields(replay),
        "lag_error_s": replay.setup.calibrations.lag_s - truth.lag_s,
        "tip_error_mm": float(np.linalg.norm(replay.setup.calibrations.tip.xyz_mm[0] - truth.tip.xyz_mm[0])),
    }
    images = replay.scenario.ultrasound.images
    if images is not None:
        out["probe_error_mm"] = far_corner_error_mm(
            replay.setup.calibrations.probe_from_image, truth.probe_from_image, *images.shape[1:]
        )
    errors_mm = pose_errors_mm(ticks.mr_from_tracker, ticks.t_s, truth)
    if valid.any():
        out["tre_mm"] = summarise_errors(errors_mm[valid].ravel()).tre_fields()
    distance, true_force = true_contact(replay)
    out |= _hazard(replay, truth, None if true_force is None else distance)
    phi, model_phase = true_phases(replay)
    locked = track.valid
    if locked.any():
        score = score_phase(
            track.phi[locked], ticks.model_phase[locked], phi[locked], model_phase[locked], truth.surface
        )
        out["phase_error_percent_rr"] = {"mean": score.percent_mean, "p95": score.percent_p95}
        out["model_phase_error_mm"] = {"mean": score.surface_mm_mean, "p95": score.surface_mm_p95}
    contact = distance >= CONTACT_MM
    with_force = ticks.guided & ticks.force_n.any(axis=1)
    out["contact"] = _contact_fields(replay, contact, with_force)
    if true_force is not None:
        believed = np.where(valid, ticks.distance_mm, np.nan)
        surface = score_surface(believed, distance, with_force, 1.0 / RATE_HZ)
        out["surface_error_mm"] = None if surface is None else asdict(surface)
        force = score_force(ticks.force_n, valid & ticks.guided, true_force, contact)
        if force is not None:
            out["force_error_n"] = {"median": force.error_n_median, "p95": force.error_n_p95}
    return out


def _contact_fields(replay: Replay, contact: BoolArray, with_force: BoolArray) -> dict[str, float]:
    """Compute the share of ticks in contact, and of those with a force, also where the model knows the heart.

    Args:
        contact, with_force: (n,) whether the tip is truly in contact in a tick, and whether it has a force.
    """
    modelled = contact & _modelled_at_tip(replay, contact)
    return {
        "ticks": int(contact.sum()),
        "share": float(contact.mean()),
        "served_share": float(with_force[contact].mean()) if contact.any() else 0.0,
        "known_share": float(modelled.sum() / max(1, contact.sum())),
        "served_known_share": float(with_force[modelled].mean()) if modelled.any() else 0.0,
    }


def _modelled_at_tip(replay: Replay, chosen: BoolArray) -> BoolArray:
    """Flag (n,) chosen ticks where the model knows the heart at the true tip; False at others."""
    truth = replay.scenario.truth
    if truth is None:
        raise InvalidInputError("the scenario carries no truth")
    nearest = _nearest(truth.tool.t_s, replay.ticks.t_s[chosen])
    model = replay.setup.heart.model
    samples = Fixtures(model).evaluate(
        Rigid.identity(model.frame, model.frame),
        truth.tool.tip_mr_mm[nearest],
        truth.tool.model_phase[nearest],
    )
    out = np.zeros(len(chosen), dtype=np.bool_)
    out[chosen] = samples.status == Status.OK
    return out


def _hazard(replay: Replay, truth: ScenarioTruth, distance_mm: FloatArray | None) -> dict[str, float]:
    """Sum the seconds of force where guidance is far off; a fading force counts for the last pose.

    Args:
        distance_mm: (n,) true distance of the guarded wall; None if a fixture is not on it.
    """
    ticks, updates = replay.ticks, tuple(replay.history.updates)
    last = last_of(np.isfinite(ticks.mr_from_tracker[:, 0, 0]))
    poses = np.where((last >= 0)[:, None, None], ticks.mr_from_tracker[last], np.nan)
    error_mm = pose_errors_mm(poses, ticks.t_s, truth).mean(axis=1)
    if distance_mm is not None:
        wall_mm = np.where(ticks.valid, np.abs(ticks.distance_mm - distance_mm), np.nan)
        warped = np.array([*(update.warp is not None for update in updates), False])
        followed = warped[updates_in_force(updates, ticks.t_s)]
        error_mm = guidance_errors_mm(error_mm, wall_mm, followed)
    score = score_hazard(ticks.force_n, error_mm, 1.0 / RATE_HZ)
    return {"hazard_s": score.total_s, "hazard_longest_s": score.longest_s}


def margin_fields(replay: Replay) -> dict[str, Any]:
    """Compute the primary fixture's margin over valid ticks, and the depth of its wall in the organ.

    The violation depth is that by which a forbidden region, widened, lies inside the true one at the tool
    (`score_violation`); None without a truth, or for guidance.
    """
    ticks, fixtures = replay.ticks, replay.setup.fixtures
    width = ticks.margin_mm[ticks.valid]
    out: dict[str, Any] = {
        "mode": fixtures.margin.mode,
        "median_mm": float(np.median(width)) if len(width) else None,
        "p95_mm": float(np.percentile(width, 95)) if len(width) else None,
        "violation_mm": None,
    }
    first = fixtures.fixtures[0]
    law = first.law
    if replay.scenario.truth is not None and first.on_model and not isinstance(law, Gaussian):
        outward = -1.0 if isinstance(law, Confinement) else 1.0
        true_mm = outward * true_contact(replay)[0]
        seen = ticks.valid & (np.abs(true_mm - law.depth_mm) <= NEAR_WALL_MM)
        believed_mm = outward * ticks.distance_mm[seen] + ticks.margin_mm[seen]
        out["violation_mm"] = score_violation(true_mm[seen], believed_mm)
    return out


def true_phases(replay: Replay) -> tuple[FloatArray, FloatArray]:
    """Look up (n,) true fraction of RR and true model phase at each tick (nearest truth sample)."""
    truth = replay.scenario.truth
    if truth is None:
        raise InvalidInputError("the scenario carries no truth")
    nearest = _nearest(truth.tool.t_s, replay.ticks.t_s)
    return truth.tool.phi[nearest], truth.tool.model_phase[nearest]


def true_contact(replay: Replay) -> tuple[FloatArray, FloatArray | None]:
    """Look up (n,) true distance and (n, 3) true force (tracker frame) at each tick.

    The force is None for a path or a structure, whose distance this is not.
    """
    truth = replay.scenario.truth
    if truth is None:
        raise InvalidInputError("the scenario carries no truth")
    t_s = replay.ticks.t_s
    nearest = _nearest(truth.tool.t_s, t_s)
    distance, normal = truth.tool.distance_mm[nearest], truth.tool.normal[nearest]
    force_mr = force_at_distance(replay.setup.fixtures, distance, normal)
    if force_mr is None:
        return distance, None
    force = np.empty_like(force_mr)
    for start_s, pose in truth.mr_from_tracker:
        later = t_s >= start_s
        force[later] = force_mr[later] @ pose.rotation
    return distance, force


def _nearest(times: FloatArray, at: FloatArray) -> np.ndarray[Any, np.dtype[np.intp]]:
    right = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    return right - (at - times[right - 1] < times[right] - at)
