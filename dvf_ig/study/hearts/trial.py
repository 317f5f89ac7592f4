"""One trial: one heart, registered once from a coarse start, without landmarks, and measured by its truth."""

from dataclasses import fields
from typing import Any

import numpy as np

from dvf_ig.core import DvfIgError, FloatArray, Rigid
from dvf_ig.registration import (
    PoseChart,
    RegistrationResult,
    covariance_to_mm,
    predicted_error_mm,
    target_errors_mm,
)
from dvf_ig.registration.evidence.assessment import features_of
from dvf_ig.study.trials import Line, Settings

from .conditions import of_trial
from .registered import RegisteredHeart, registered_heart


def heart_trial(settings: Settings, number: int) -> Line:
    """One recording of one heart of a list.

    Args:
        settings: `world` ("first", "second"), `images` ("sweep": a tracked sweep, "volumes": gated 3-D
            images), `qualities` (presets of scenarios), `disturbed` (see `conditions_of`).
        number: of the trial.
    """
    heart, condition = of_trial(number, settings)
    named = {
        "world": settings["world"],
        "images": settings["images"],
        "quality": condition.quality,
        "disturbed": condition.disturbed,
        "heart": heart,
    }
    try:
        done = registered_heart(settings, number)
    except DvfIgError as exc:
        return {**named, "refused": str(exc)}
    return {**named, **done.drawn, **_measured(done)}


def _measured(done: RegisteredHeart) -> Line:
    """Errors at the targets, and what the result says of itself."""
    result = done.result
    errors = target_errors_mm(result.target_from_source, done.known.truth, done.known.targets)
    return {
        "start_mm": float(target_errors_mm(done.start, done.known.truth, done.known.targets).mean()),
        "floor_mm": done.floor_mm,
        "tre_mm": float(errors.mean()),
        "tre_p95_mm": float(np.percentile(errors, 95)),
        "tre_max_mm": float(errors.max()),
        "chi2": _chi2(result, done.known.truth),
        "covariance_scale": result.covariance_scale,
        "stop": result.stop.name,
        "usable": result.stop.usable,
        "success_probability": result.success_probability,
        "tre_bound_mm": result.tre_bound_mm,
        "features": features_of(
            result.evidence,
            result.similarity,
            predicted_error_mm(result.covariance / result.covariance_scale),
        ),
        "statistics": None if result.statistics is None else result.statistics.values(),
        "offset_mm": _offset(result, done.known.truth),
        "covariance_mm2": _listed(result.covariance),
        "similarity": result.similarity,
        "moved_mm": result.moved_mm,
        "overlap": result.overlap,
        "sigma_mm": _sigma_mm(result.covariance),
        "seconds": result.seconds,
        **_numbers_of(result.evidence),
    }


def _chi2(result: RegistrationResult, truth: Rigid) -> float | None:
    """Squared error of the pose by its covariance, of 6 degrees of freedom; None without a covariance."""
    if not np.isfinite(result.covariance).all():
        return None
    off = PoseChart(result.target_from_source, result.center_mm).coordinates(truth)
    return float(off @ np.linalg.solve(covariance_to_mm(result.covariance), off))


def _offset(result: RegistrationResult, truth: Rigid) -> list[float]:
    """The true pose in the coordinates of `PoseChart` about the result."""
    return [float(v) for v in PoseChart(result.target_from_source, result.center_mm).coordinates(truth)]


def _listed(covariance: FloatArray) -> list[list[float]] | None:
    known = bool(np.isfinite(covariance).all())
    return [[float(v) for v in row] for row in covariance_to_mm(covariance)] if known else None


def _sigma_mm(covariance: FloatArray) -> float | None:
    mean = float(np.trace(covariance_to_mm(covariance))) / 6.0
    return float(np.sqrt(mean)) if np.isfinite(mean) else None


def _numbers_of(evidence: Any) -> Line:
    """Every number of the evidence by its name, None where it was not tested or is infinite."""
    values = {field.name: getattr(evidence, field.name) for field in fields(evidence)}
    return {
        name: float(value) if isinstance(value, float) and np.isfinite(value) else None
        for name, value in values.items()
        if value is None or isinstance(value, float)
    }
