"""Content of `result.json`: every estimate of a replay, and its error if the truth is known."""

from dataclasses import asdict
from typing import Any

import numpy as np

from dvf_ig.cardiac import frame_period_s
from dvf_ig.guidance import Status, summarise_supervision
from dvf_ig.intake.fixtures import DeviceConfig
from dvf_ig.replay.engine import Replay
from dvf_ig.session.reasons import no_force

from .errors import ERROR_FIELDS, error_fields, margin_fields
from .evidence import attempt_fields
from .pose import age_fields, bound_fields, pose_bound_fields, tip_field, update_fields
from .schema import SCHEMA, validate


def result_of(replay: Replay) -> dict[str, Any]:
    """Collect all estimates of a replay, with their errors if the scenario has its truth."""
    ticks, force = replay.ticks, replay.ticks.force_n
    magnitude = np.linalg.norm(force, axis=1)
    valid = ticks.valid
    device = DeviceConfig.of(replay.setup.device)
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
        "retiming": replay.setup.retiming,
        "margin": margin_fields(replay),
        "no_force": _no_force(replay),
        "warnings": [{"key": f.key, "cause": f.cause.name, "sentence": f.sentence} for f in replay.findings],
        "estimates": _estimates(replay),
        **update_fields(replay),
        "supervisor": asdict(summarise_supervision(ticks.t_s, ticks.supervisor, force)),
        "pose_age_s": age_fields(ticks),
        "tip_in_image": tip_field(replay),
        "breathing": asdict(replay.history.breathing[-1]) if replay.history.breathing else None,
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
    return no_force(counts, posed=bool(replay.poses), reason=reason)


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
