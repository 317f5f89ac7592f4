"""Registrations as `result.json` lists them: their poses and their evidence."""

from typing import Any

import numpy as np

from dvf_ig.registration import PairEvidence, RegistrationResult, ShapeChange, least_constrained_direction
from dvf_ig.session import RegistrationRecord


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
        "wall": shape.wall,
        "outward_mm": shape.shift_mm,
        "sigma_mm": shape.sigma_mm,
        "seen_walls_mm": shape.seen_mm,
        "scale_mm": shape.scale_mm,
        "log_evidence": shape.evidence,
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
