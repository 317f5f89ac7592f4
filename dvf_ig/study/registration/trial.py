"""One trial of a registration experiment: register from a known start, measure the error against the truth.

The registration problem stays in memory while its trials are worked through.
"""

import json
from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy.optimize import bisect

from data_synth.seeds import child_rng
from dvf_ig.core import HEART_RADIUS_MM, DvfIgError, FloatArray, NotConvergedError, Points, Rigid
from dvf_ig.registration import pose_difference, target_errors_mm
from dvf_ig.study.trials import Line, Settings

from .baselines import mattes
from .experiments import trials_per_condition
from .problem import RegistrationProblem, make_problem


def registration_trial(settings: Settings, number: int) -> Line:
    """One registration from a known start; a refusal keeps the line's labels (`trials.Work`).

    Args:
        settings: from `experiments.settings_of`.
        number: one of `experiments.trial_numbers`.
    """
    group, k = divmod(number, trials_per_condition(settings))
    pair, which = divmod(group, len(settings["conditions"]))
    condition = settings["conditions"][which]
    ours = k < len(settings["starts_mm"])
    line = {
        "pair": pair,
        "arm": settings["arm"],
        "method": "dvf_ig" if ours else "Mattes MI",
        **{name: condition[name] for name in ("motion", "quality", "condition")},
    }
    problem = _problem(pair, json.dumps(condition))
    start = trial_start(settings, number, problem)
    line["start_mm"] = _mean_error_mm(problem, start)
    try:
        found = _ours(problem, start, number) if ours else _baseline(problem, start)
    except DvfIgError as exc:
        return {**line, "refused": str(exc)}
    pose = found.pop("pose")
    turn_deg, shift_mm = pose_difference(pose, problem.truth, problem.center_mm)
    return {
        **line,
        "tre_mm": _mean_error_mm(problem, pose),
        "rotation_deg": turn_deg,
        "translation_mm": shift_mm.tolist(),
        **found,
    }


def trial_start(settings: Settings, number: int, problem: RegistrationProblem) -> Rigid:
    """The pose from which a trial begins."""
    starts = [*settings["starts_mm"], *settings["baseline_starts_mm"]]
    low, high = starts[number % trials_per_condition(settings)]
    rng = child_rng(number, "registration start")
    return start_with_error(problem, float(rng.uniform(low, high)), rng)


class KnownTruth(Protocol):
    """What the error of a pose is measured by: a true pose, targets, and a centre (3,) to turn about."""

    @property
    def truth(self) -> Rigid: ...
    @property
    def targets(self) -> Points: ...
    @property
    def center_mm(self) -> FloatArray: ...


def start_with_error(problem: KnownTruth, start_mm: float, rng: np.random.Generator) -> Rigid:
    """A pose of that mean target error: random axis, direction and share of rotation.

    Rotation ends at half a turn; what is then missing is translation.
    """
    axis, direction = rng.normal(size=3), rng.normal(size=3)
    share = rng.uniform()
    axis, direction = axis / np.linalg.norm(axis), direction / np.linalg.norm(direction)

    def displaced(size_mm: float) -> Rigid:
        turn = min(size_mm * share / HEART_RADIUS_MM, np.pi) * axis
        return problem.truth.perturbed_left(turn, size_mm * (1.0 - share) * direction, problem.center_mm)

    def excess_mm(size_mm: float) -> float:
        return _mean_error_mm(problem, displaced(size_mm)) - start_mm

    if excess_mm(0.0) >= 0.0:
        return problem.truth  # an error of rounding's size was asked for
    high = 20.0 * start_mm + 1.0
    while excess_mm(high) < 0.0:
        high *= 2.0
    return displaced(bisect(excess_mm, 0.0, high, xtol=1e-12))


def _ours(problem: RegistrationProblem, start: Rigid, number: int) -> Line:
    result = problem.register(start, np.random.default_rng(number))
    return {
        "pose": result.target_from_source,
        "stop": result.stop.name,
        "usable": result.stop.usable,
        "success_probability": result.success_probability,
        "seconds": result.seconds,
        "similarity": result.similarity,
        "contrast": result.evidence.z_score,
        "halves_mm": _finite(result.evidence.split_half_mm),
        "phases_mm": _finite(result.evidence.phase_mm),
        "parts_mm": result.evidence.half_volume_mm,
        "edges_mm": result.evidence.boundary_mm,
        "sigma_mm": _finite(_sigma_mm(result.covariance)),
        "evaluations": result.evaluations,
    }


def _baseline(problem: RegistrationProblem, start: Rigid) -> Line:
    if problem.fixed is None or problem.mask is None or problem.moving is None:
        raise TypeError("this registration problem has no volume for a baseline")
    found = mattes(problem.fixed, problem.mask, problem.moving, start, problem.center_mm)
    if found.moving_from_fixed is None:
        raise NotConvergedError(f"{found.name}: {found.note}")
    return {"pose": found.moving_from_fixed, "stop": found.note, "seconds": found.seconds}


def _sigma_mm(covariance: FloatArray) -> float:
    """Standard deviation per coordinate at the heart's radius, RMS over the six."""
    variance = np.diag(covariance) * np.array([HEART_RADIUS_MM**2] * 3 + [1.0] * 3)
    return float(np.sqrt(variance.mean()))


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


@lru_cache(maxsize=1)
def _problem(pair: int, condition: str) -> RegistrationProblem:
    return make_problem(pair, json.loads(condition))


def _mean_error_mm(problem: KnownTruth, pose: Rigid) -> float:
    return float(target_errors_mm(pose, problem.truth, problem.targets).mean())
