"""What a replay reports as `result.json`, and its schema."""

import json
from dataclasses import asdict
from importlib import resources
from typing import Any

import numpy as np
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from dvf_ig.cardiac import frame_period_s
from dvf_ig.core import FloatArray, InvalidInputError, ScenarioTruth, summarise_errors
from dvf_ig.guidance import Confinement, Gaussian, Status, force_at_distance, summarise_supervision
from dvf_ig.registration import (
    PairEvidence,
    RegistrationResult,
    least_constrained_direction,
    target_errors_mm,
)
from dvf_ig.session import Attempt

from .engine import Replay
from .no_force import no_force_of
from .pose_summary import summarise_poses
from .preconditions import RATE_HZ
from .score import (
    CONTACT_MM,
    NEAR_WALL_MM,
    far_corner_error_mm,
    pose_errors_mm,
    score_force,
    score_hazard,
    score_phase,
    score_violation,
)
from .ticks import Ticks

SCHEMA = "dvf_ig.replay/1"


def schema() -> dict[str, Any]:
    """The JSON schema of result.json."""
    text = resources.files(__package__).joinpath("result.schema.json").read_text(encoding="utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def validate(result: dict[str, Any]) -> None:
    """Raise InvalidInputError unless `result` fits the schema."""
    error = best_match(Draft202012Validator(schema()).iter_errors(result))
    if error is not None:
        raise InvalidInputError(f"result.json does not fit {SCHEMA}: {error.message}") from error


def result_of(replay: Replay) -> dict[str, Any]:
    """Every estimate of a replay, and beside it its error where the scenario carries its truth."""
    ticks, force = replay.ticks, replay.ticks.force_n
    magnitude = np.linalg.norm(force, axis=1)
    valid = ticks.valid
    out: dict[str, Any] = {
        "schema": SCHEMA,
        "scenario": replay.scenario.name,
        "preset": replay.scenario.preset,
        "seed": replay.scenario.seed,
        "patient_id": replay.scenario.preop.patient_id,
        "ticks": len(ticks),
        "valid_ticks": int(valid.sum()),
        "refused_ticks": int((~valid).sum()),
        "refused_by_status": _refusals(replay),
        "nonfinite_ticks": int((~np.isfinite(force).all(axis=1)).sum()),
        "valid_phase_share": float(ticks.phase.valid.mean()),
        "force_n": {
            "max": float(np.nanmax(magnitude)),
            "mean": float(magnitude[valid].mean()) if valid.any() else 0.0,
        },
        "seconds": round(replay.seconds, 3),
        "session_seconds": round(replay.session_seconds, 3),
        "fixtures": [one.described() for one in replay.setup.fixtures.fixtures],
        "fixtures_cap_n": replay.setup.fixtures.joint_cap_n,
        "retiming": replay.setup.retiming,
        "margin": margin_of(replay),
        "no_force": no_force_of(replay),
        "warnings": [{"key": f.key, "cause": f.cause.name, "sentence": f.sentence} for f in replay.findings],
        "estimates": _estimates(replay),
        **_pose_updates(replay),
        "supervisor": asdict(summarise_supervision(ticks.t_s, ticks.supervisor, force)),
        "pose_age_s": _pose_age(ticks),
        "registrations": [_attempt(a) for a in replay.attempts],
        "tre_bound_mm": _bounds(replay),
        **dict.fromkeys(
            (
                "tre_mm",
                "start_tre_mm",
                "phase_error_percent_rr",
                "model_phase_error_mm",
                "force_error_n",
                "contact",
                "lag_error_s",
                "probe_error_mm",
                "tip_error_mm",
                "hazard_s",
                "hazard_longest_s",
            )
        ),
    }
    out.update(_errors(replay))
    validate(out)
    return out


def _refusals(replay: Replay) -> dict[str, int]:
    return {
        status.name.lower(): int((replay.ticks.status == status).sum())
        for status in Status
        if status is not Status.OK
    }


def _estimates(replay: Replay) -> dict[str, Any]:
    evidence, in_use, track = replay.calibrations, replay.setup.calibrations, replay.ticks.phase
    locked = track.valid
    rr_s = float(np.median(track.rr_s[locked])) if locked.any() else None
    model = replay.heart.model
    poses = replay.poses
    return {
        "tip_mm": in_use.tip.xyz_mm[0].tolist(),
        "pivot_rms_3d_mm": None if evidence.pivot is None else evidence.pivot.rms_3d_mm,
        "probe_from_image": in_use.probe_from_image.matrix.tolist(),
        "probe_calibration_mean95_mm": None
        if evidence.probe is None
        else evidence.probe.calibration.summary.mean95,
        "lag_s": in_use.lag_s,
        "lag_correlation": None if evidence.latency is None else evidence.latency.correlation,
        "beats": len(replay.history.peaks),
        "rr_s": rr_s,
        "frame_period_s": frame_period_s(rr_s, model.phases) if rr_s else None,
        "model_rr_s": model.timing.rr_s,
        "phases": model.phases,
        "model_megabytes": model.megabytes,
        "start_mr_from_tracker": replay.start.matrix.tolist(),
        "mr_from_tracker": poses[-1][1].matrix.tolist() if poses else None,
    }


def _pose_updates(replay: Replay) -> dict[str, Any]:
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


def _withheld_s(ticks: Ticks) -> float:
    """Seconds after the first pose in which none could be used: suspended, or confirmed by no beat."""
    posed = np.isfinite(ticks.mr_from_tracker[:, 0, 0])
    lasts_s = np.diff(ticks.t_s, append=ticks.t_s[-1:] + 1.0 / RATE_HZ)
    return round(float(lasts_s[np.maximum.accumulate(posed) & ~posed].sum()), 6)


def _pose_age(ticks: Ticks) -> dict[str, float] | None:
    """Age of the pose over the ticks that gave a force: time since a beat confirmed it."""
    age_s = ticks.pose_age_s[ticks.valid]
    return {"median": float(np.median(age_s)), "max": float(age_s.max())} if len(age_s) else None


def _bounds(replay: Replay) -> dict[str, float | None] | None:
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


def _attempt(attempt: Attempt) -> dict[str, Any]:
    result = attempt.result
    out: dict[str, Any] = {
        "asked_s": attempt.asked_s,
        "ready_s": attempt.ready_s,
        "usable": attempt.usable,
        "frames": 0 if attempt.frames is None else len(attempt.frames.used),
        "frames_rejected": {} if attempt.frames is None else attempt.frames.gated.rejected,
        "stop": result.stop.name if result else "TOO_FEW_FRAMES",
        "reason": attempt.reason,
    }
    if result is not None:
        out |= {"mr_from_tracker": result.target_from_source.matrix.tolist(), **evidence_of(result)}
    return out


def evidence_of(result: RegistrationResult) -> dict[str, Any]:
    """What speaks for or against a registration, under the names every command uses."""
    finite = bool(np.isfinite(result.covariance).all())
    offset = result.evidence.phase_offset
    return {
        "success_probability": result.success_probability,
        "tre_bound_mm": result.tre_bound_mm,
        "outside": result.outside,
        "covariance": result.covariance.tolist() if finite else None,
        "covariance_about_mm": result.center_mm.tolist(),
        "weakness": least_constrained_direction(result.covariance).sentence(),
        "similarity": result.similarity,
        "start_similarity": result.start_similarity,
        "second_best": result.second_best,
        "contrast": result.evidence.z_score,
        "overlap": result.overlap,
        "disagreement_mm": _finite(result.evidence.split_half_mm),
        "phase_disagreement_mm": _finite(result.evidence.phase_mm),
        "part_disagreement_mm": _finite(result.evidence.half_volume_mm),
        "edge_disagreement_mm": _finite(result.evidence.boundary_mm),
        "phase_offset_s": None if offset is None else offset.offset_s,
        **_pair_evidence(result.evidence.pair),
        "moved_mm": result.moved_mm,
        "image_statistics": None if result.statistics is None else result.statistics.values(),
        "slices": result.slices,
        "seconds": round(result.seconds, 3),
    }


def _pair_evidence(pair: PairEvidence | None) -> dict[str, Any]:
    """Of a pair of images of an organ that does not beat; all None of a heart."""
    return {
        "pair_statistic": None if pair is None else _finite(pair.doubt),
        "agreeing_starts": None if pair is None else pair.agreeing_starts,
        "next_best_share": None if pair is None else pair.next_best_share,
        "jackknife_mm": None if pair is None else _finite(pair.jackknife_mm),
        "mirrored_share": None if pair is None else pair.mirrored_share,
    }


def _errors(replay: Replay) -> dict[str, Any]:
    """Estimates against the ground truth; empty where there is none."""
    truth = replay.scenario.truth
    if truth is None:
        return {}
    ticks, track, valid = replay.ticks, replay.ticks.phase, replay.ticks.valid
    start_errors = target_errors_mm(replay.start, truth.mr_from_tracker_at(0.0), truth.targets.points)
    out: dict[str, Any] = {
        "start_tre_mm": summarise_errors(start_errors).tre_fields(),
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
    out |= _hazard(ticks, truth)
    phi, model_phase = true_phases(replay)
    locked = track.valid
    if locked.any():
        score = score_phase(
            track.phi[locked], ticks.model_phase[locked], phi[locked], model_phase[locked], truth.surface
        )
        out["phase_error_percent_rr"] = {"mean": score.percent_mean, "p95": score.percent_p95}
        out["model_phase_error_mm"] = {"mean": score.surface_mm_mean, "p95": score.surface_mm_p95}
    distance, true_force = true_contact(replay)
    contact = distance >= CONTACT_MM
    given = ticks.guided & ticks.force_n.any(axis=1)
    out["contact"] = {
        "ticks": int(contact.sum()),
        "share": float(contact.mean()),
        "served_share": float(given[contact].mean()) if contact.any() else 0.0,
    }
    if true_force is not None:
        force = score_force(ticks.force_n, valid & ticks.guided, true_force, contact)
        if force is not None:
            out["force_error_n"] = {"median": force.error_n_median, "p95": force.error_n_p95}
    return out


def _hazard(ticks: Ticks, truth: ScenarioTruth) -> dict[str, float]:
    """Seconds of force on a pose that is far off; a fading force is one on the last pose."""
    posed = np.isfinite(ticks.mr_from_tracker[:, 0, 0])
    last = np.maximum.accumulate(np.where(posed, np.arange(len(ticks)), -1))
    poses = np.where((last >= 0)[:, None, None], ticks.mr_from_tracker[last], np.nan)
    error_mm = pose_errors_mm(poses, ticks.t_s, truth).mean(axis=1)
    score = score_hazard(ticks.force_n, error_mm, 1.0 / RATE_HZ)
    return {"hazard_s": score.total_s, "hazard_longest_s": score.longest_s}


def margin_of(replay: Replay) -> dict[str, Any]:
    """Width of the primary fixture's margin over valid ticks, and how deep its wall stands in the organ.

    The violation depth is that by which a forbidden region, widened, stands inside the true one at the tool
    (`score_violation`); None without a truth, or of guidance.
    """
    ticks, fixtures = replay.ticks, replay.setup.fixtures
    width = ticks.margin_mm[ticks.valid]
    out: dict[str, Any] = {
        "mode": fixtures.margin.mode,
        "median_mm": float(np.median(width)) if len(width) else None,
        "p95_mm": float(np.percentile(width, 95)) if len(width) else None,
        "violation_mm": None,
    }
    law = fixtures.fixtures[0].law
    if replay.scenario.truth is not None and not isinstance(law, Gaussian):
        outward = -1.0 if isinstance(law, Confinement) else 1.0
        true_mm = outward * true_contact(replay)[0]
        seen = ticks.valid & (np.abs(true_mm - law.depth_mm) <= NEAR_WALL_MM)
        believed_mm = outward * ticks.distance_mm[seen] + ticks.margin_mm[seen]
        out["violation_mm"] = score_violation(true_mm[seen], believed_mm)
    return out


def true_phases(replay: Replay) -> tuple[FloatArray, FloatArray]:
    """(n,) true fraction of RR and true model phase at each tick (nearest truth sample)."""
    truth = replay.scenario.truth
    if truth is None:
        raise InvalidInputError("the scenario carries no truth")
    nearest = _nearest(truth.tool.t_s, replay.ticks.t_s)
    return truth.tool.phi[nearest], truth.tool.model_phase[nearest]


def true_contact(replay: Replay) -> tuple[FloatArray, FloatArray | None]:
    """(n,) true distance and (n, 3) true force in the tracker's frame at each tick; None for a path."""
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


def _nearest(times: FloatArray, wanted: FloatArray) -> np.ndarray[Any, np.dtype[np.intp]]:
    right = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    return right - (wanted - times[right - 1] < times[right] - wanted)


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None
