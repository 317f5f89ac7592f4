"""What a replay reports as `result.json`, and its schema."""

import json
from importlib import resources
from typing import Any

import jsonschema
import numpy as np

from dvf_ig.cardiac import frame_period_s
from dvf_ig.core import FloatArray, InvalidInputError, summarise_errors
from dvf_ig.guidance import Sigmoid, Status
from dvf_ig.guidance.blend import static_force
from dvf_ig.registration import RegistrationResult, least_constrained_direction, target_errors_mm

from .engine import Replay
from .pose_history import Attempt
from .pose_summary import summarise_poses
from .score import CONTACT_MM, far_corner_error_mm, score_force, score_phase, score_poses

SCHEMA = "dvf_ig.replay/1"


def schema() -> dict[str, Any]:
    """The JSON schema of result.json."""
    text = resources.files(__package__).joinpath("result.schema.json").read_text(encoding="utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def validate(result: dict[str, Any]) -> None:
    """Raise InvalidInputError unless `result` fits the schema."""
    try:
        jsonschema.validate(result, schema())
    except jsonschema.ValidationError as exc:
        raise InvalidInputError(f"result.json does not fit {SCHEMA}: {exc.message}") from exc


def result_of(replay: Replay) -> dict[str, Any]:
    """Every estimate of a replay, and beside it its error where the scenario carries its truth."""
    track, force = replay.phase_tracking.track, replay.samples.force_n
    magnitude = np.linalg.norm(force, axis=1)
    valid = replay.valid
    out: dict[str, Any] = {
        "schema": SCHEMA,
        "scenario": replay.scenario.name,
        "preset": replay.scenario.preset,
        "seed": replay.scenario.seed,
        "patient_id": replay.scenario.preop.patient_id,
        "ticks": len(track.t_s),
        "valid_ticks": int(valid.sum()),
        "refused_ticks": int((~valid).sum()),
        "refused_by_status": _refusals(replay),
        "nonfinite_ticks": int((~np.isfinite(force).all(axis=1)).sum()),
        "valid_phase_share": float(track.valid.mean()),
        "force_n": {
            "max": float(np.nanmax(magnitude)),
            "mean": float(magnitude[valid].mean()) if valid.any() else 0.0,
        },
        "seconds": round(replay.seconds, 3),
        "estimates": _estimates(replay),
        **_pose_updates(replay),
        "registrations": [_attempt(a) for a in replay.attempts],
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
            )
        ),
    }
    out.update(_errors(replay))
    validate(out)
    return out


def _refusals(replay: Replay) -> dict[str, int]:
    return {
        status.name.lower(): int((replay.samples.status == status).sum())
        for status in Status
        if status is not Status.OK
    }


def _estimates(replay: Replay) -> dict[str, Any]:
    calibrations, track = replay.calibrations, replay.phase_tracking.track
    locked = track.valid
    rr_s = float(np.median(track.rr_s[locked])) if locked.any() else None
    model = replay.heart.model
    poses = replay.poses
    return {
        "tip_mm": calibrations.pivot.tip.xyz_mm[0].tolist(),
        "pivot_rms_3d_mm": calibrations.pivot.rms_3d_mm,
        "probe_from_image": calibrations.probe.probe_from_image.matrix.tolist(),
        "probe_calibration_mean95_mm": calibrations.probe.calibration.summary.mean95,
        "lag_s": calibrations.latency.lag_s,
        "lag_correlation": calibrations.latency.correlation,
        "beats": len(replay.phase_tracking.peaks),
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
    t_s = replay.phase_tracking.track.t_s
    done = summarise_poses(replay.history, replay.heart.center_mm, float(t_s[-1]))
    return {
        "tracked_beats": done.tracked_beats,
        "drift_mm_per_min": done.drift_mm_per_min,
        "update_seconds": None
        if done.update_s_median is None
        else {"median": done.update_s_median, "p95": done.update_s_p95},
        "withheld_s": done.withheld_s,
        "doubts_s": [list(span) for span in done.suspended_s],
    }


def _attempt(attempt: Attempt) -> dict[str, Any]:
    result = attempt.result
    out: dict[str, Any] = {
        "asked_s": attempt.asked_s,
        "ready_s": attempt.ready_s,
        "usable": attempt.usable,
        "frames": len(attempt.frames.used),
        "frames_rejected": attempt.frames.gated.rejected,
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
        "moved_mm": result.moved_mm,
        "slices": result.slices,
        "seconds": round(result.seconds, 3),
    }


def _errors(replay: Replay) -> dict[str, Any]:
    """Estimates against the ground truth; empty where there is none."""
    truth = replay.scenario.truth
    if truth is None:
        return {}
    track, valid = replay.phase_tracking.track, replay.valid
    start_errors = target_errors_mm(replay.start, truth.mr_from_tracker_at(0.0), truth.targets.points)
    out: dict[str, Any] = {
        "start_tre_mm": summarise_errors(start_errors).tre_fields(),
        "lag_error_s": replay.calibrations.latency.lag_s - truth.lag_s,
        "tip_error_mm": float(np.linalg.norm(replay.calibrations.pivot.tip.xyz_mm[0] - truth.tip.xyz_mm[0])),
    }
    images = replay.scenario.ultrasound.images
    if images is not None:
        out["probe_error_mm"] = far_corner_error_mm(
            replay.calibrations.probe.probe_from_image, truth.probe_from_image, *images.shape[1:]
        )
    poses = score_poses(replay.poses, track.t_s, valid, truth)
    if poses is not None:
        out["tre_mm"] = poses[0].tre_fields()
    phi, model_phase = true_phases(replay)
    locked = track.valid
    if locked.any():
        score = score_phase(
            track.phi[locked], replay.model_phase[locked], phi[locked], model_phase[locked], truth.surface
        )
        out["phase_error_percent_rr"] = {"mean": score.percent_mean, "p95": score.percent_p95}
        out["model_phase_error_mm"] = {"mean": score.surface_mm_mean, "p95": score.surface_mm_p95}
    distance, true_force = true_contact(replay)
    contact = distance >= CONTACT_MM
    force = score_force(replay.samples.force_n, valid, true_force, contact)
    out["contact"] = {
        "ticks": int(contact.sum()),
        "share": float(contact.mean()),
        "served_share": force.force_ticks / force.contact_ticks if force else 0.0,
    }
    if force is not None:
        out["force_error_n"] = {"median": force.error_n_median, "p95": force.error_n_p95}
    return out


def true_phases(replay: Replay) -> tuple[FloatArray, FloatArray]:
    """(n,) true fraction of RR and true model phase at each tick (nearest truth sample)."""
    truth = replay.scenario.truth
    if truth is None:
        raise InvalidInputError("the scenario carries no truth")
    nearest = _nearest(truth.tool.t_s, replay.phase_tracking.track.t_s)
    return truth.tool.phi[nearest], truth.tool.model_phase[nearest]


def true_contact(replay: Replay) -> tuple[FloatArray, FloatArray]:
    """(n,) true distance and (n, 3) true force in the tracker's frame at each tick."""
    truth = replay.scenario.truth
    if truth is None:
        raise InvalidInputError("the scenario carries no truth")
    t_s = replay.phase_tracking.track.t_s
    nearest = _nearest(truth.tool.t_s, t_s)
    distance, normal = truth.tool.distance_mm[nearest], truth.tool.normal[nearest]
    force_mr = static_force(Sigmoid(), distance, normal)
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
