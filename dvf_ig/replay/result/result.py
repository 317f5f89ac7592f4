"""Content of `result.json` and its schema: every estimate, and its error if the truth is known."""

import json
from dataclasses import asdict
from importlib import resources
from typing import Any

import numpy as np
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from dvf_ig.cardiac import frame_period_s
from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import Status, summarise_supervision
from dvf_ig.intake.fixtures import DeviceConfig, ToolShapeConfig
from dvf_ig.registration import PairEvidence, RegistrationResult, ShapeChange, least_constrained_direction
from dvf_ig.replay.engine import Replay
from dvf_ig.session import RegistrationRecord
from dvf_ig.session.reasons import no_force

from .errors import ERROR_FIELDS, error_fields, margin_fields
from .pose import age_fields, bound_fields, pose_bound_fields, tip_field, update_fields

SCHEMA = "dvf_ig.replay/1"


def schema() -> dict[str, Any]:
    """Load the JSON schema of result.json."""
    text = resources.files(__package__).joinpath("result.schema.json").read_text(encoding="utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def validate(result: dict[str, Any]) -> None:
    """Raise InvalidInputError unless `result` fits the schema."""
    error = best_match(Draft202012Validator(schema()).iter_errors(result))
    if error is not None:
        raise InvalidInputError(f"result.json does not fit {SCHEMA}: {error.message}") from error


def attempt_fields(attempt: RegistrationRecord) -> dict[str, Any]:
    """List one registration that was asked for, with its evidence if it gave a pose."""
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
    """Evidence of a registration, under the names every command uses."""
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
        "shape_change": _shape_change(result.shape),
        **_pair_evidence(result.evidence.pair),
        "moved_mm": result.moved_mm,
        "image_statistics": None if result.statistics is None else result.statistics.values(),
        "slices": result.slices,
        "seconds": round(result.seconds, 3),
    }


def _shape_change(shape: ShapeChange | None) -> dict[str, Any] | None:
    """Change of the heart's shape; None if none was found."""
    if shape is None:
        return None
    return {
        "sentence": shape.sentence,
        "followed": shape.followed is not None,
        "wall": shape.wall,
        "outward_mm": shape.shift_mm,
        "sigma_mm": shape.sigma_mm,
        "seen_walls_mm": shape.seen_mm,
        "scale_mm": shape.scale_mm,
        "log_evidence": shape.evidence,
        "contraction": shape.warp.contraction,
        "steepest": shape.warp.steepest,
        "shared_error": shape.shared,
        "held_out": None if shape.halves is None else _finite(shape.halves.held_out),
        "halves_apart_mm": None if shape.halves is None else _finite(shape.halves.apart_mm),
    }


def _pair_evidence(pair: PairEvidence | None) -> dict[str, Any]:
    """Evidence of a pair of images of an organ that does not beat; all None for a heart."""
    return {
        "pair_statistic": None if pair is None else _finite(pair.doubt),
        "agreeing_starts": None if pair is None else pair.agreeing_starts,
        "next_best_share": None if pair is None else pair.next_best_share,
        "jackknife_mm": None if pair is None else _finite(pair.jackknife_mm),
        "mirrored_share": None if pair is None else pair.mirrored_share,
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def result_of(replay: Replay) -> dict[str, Any]:
    """Collect all estimates of a replay, with their errors if the scenario has its truth."""
    ticks, force = replay.ticks, replay.ticks.force_n
    magnitude = np.linalg.norm(force, axis=1)
    valid = ticks.valid
    device = DeviceConfig.of(replay.setup.device)
    tool = ToolShapeConfig.of(replay.setup.fixtures.tool)
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
        "device": None if device is None else device.model_dump(),
        "tool": None if tool is None else tool.model_dump(mode="json"),
        "retiming": replay.setup.retiming,
        "margin": margin_fields(replay),
        "no_force": _no_force(replay),
        "warnings": [{"key": f.key, "cause": f.cause.name, "sentence": f.sentence} for f in replay.findings],
        "estimates": _estimates(replay),
        **update_fields(replay),
        "supervisor": asdict(summarise_supervision(ticks.t_s, ticks.supervisor, force)),
        "pose_age_s": age_fields(ticks),
        "tip_in_image": tip_field(replay),
        "breathing": replay.history.breathing[-1].described() if replay.history.breathing else None,
        "registrations": [attempt_fields(a) for a in replay.attempts],
        "tre_bound_mm": bound_fields(replay),
        "pose_bound_mm": pose_bound_fields(replay),
        **dict.fromkeys(ERROR_FIELDS),
    }
    out.update(error_fields(replay))
    validate(out)
    return out


def _no_force(replay: Replay) -> str | None:
    """Why no tick gave a force; None if one did."""
    codes, numbers = np.unique(replay.ticks.status, return_counts=True)
    counts = {Status(code): n for code, n in zip(codes.tolist(), numbers.tolist(), strict=True)}
    reason = replay.attempts[-1].reason if replay.attempts else None
    whole = replay.heart.model.seen is None
    return no_force(counts, posed=bool(replay.poses), reason=reason, whole=whole)


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
