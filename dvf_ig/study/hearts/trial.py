"""One trial: one heart, registered once from a coarse start, without landmarks, and measured by its truth."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from data_synth import (
    PRESETS,
    HeartSpec,
    PairSpec,
    Preset,
    ScenarioSpec,
    child_rng,
    image_pair,
    phantom_scenario,
)
from dvf_ig.core import FloatArray, Points, Rigid, Scenario, read_only_arrays
from dvf_ig.registration import PoseChart, RegistrationResult, covariance_to_mm, target_errors_mm
from dvf_ig.replay import register_scenario
from dvf_ig.study.registration.problem import GATED, volume_problem
from dvf_ig.study.registration.trial import KnownTruth, start_with_error
from dvf_ig.study.trials import Line, Settings

VARIED = HeartSpec("varied")
"""Drawn from a population of healthy, dilated and hypertrophic hearts."""
MOTION = ("paper5mm", "physiological")
"""Of hearts with even and with odd numbers."""
SWEEP_S = 14.0
"""Length of a tracked sweep: what a session has seen when it registers first, and as much again."""
START_MM = (4.0, 12.0)
"""Mean error of the start over the targets, drawn evenly."""
DISTURBED_START_MM = (4.0, 50.0)
DISTURBED_SWEEP_S = (4.0, 14.0)
DISTURBED_MISMATCH_MM = (1.0, 5.0)
DISTURBED_PROBE_MM = (0.0, 5.0)
DISTURBED_LATENCY_S = (0.0, 0.06)
"""Ranges from which disturbed trials draw, evenly: they make the errors between good and lost that a stated
probability is fitted to."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Truth:
    """The true mr_from_tracker, and where errors are declared."""

    truth: Rigid
    targets: Points
    center_mm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Registered:
    """A registration with its start, its truth, and what was drawn for it."""

    result: RegistrationResult
    start: Rigid
    known: KnownTruth
    drawn: dict[str, float]


def heart_trial(settings: Settings, number: int) -> Line:
    """One heart of a list.

    Args:
        settings: `world`, `images` ("sweep": a tracked sweep, "volumes": gated 3-D images), `quality` (a
            preset of the scenario), `disturbed`.
        number: seed of the heart.
    """
    rng = child_rng(number, "heart trial")
    make: Callable[..., _Registered] = {"sweep": _sweep, "volumes": _volumes}[settings["images"]]
    done = make(number, settings["quality"], settings["disturbed"], rng)
    return {**settings, "heart": number, **done.drawn, **_measured(done)}


def _sweep(seed: int, quality: str, disturbed: bool, rng: np.random.Generator) -> _Registered:
    preset, drawn = PRESETS[quality], {"sweep_s": SWEEP_S}
    if disturbed:
        preset, drawn = _disturbed(preset, rng)
    motion: Any = MOTION[seed % 2]
    spec = ScenarioSpec(quality, motion, drawn["sweep_s"], seed, changed=preset, heart=VARIED)
    scenario = _untouched(phantom_scenario(spec))
    truth = scenario.truth
    if truth is None:
        raise TypeError("a synthetic scenario has its truth")
    box = truth.surface.vertices_mm[0]
    center = (box.min(axis=0) + box.max(axis=0)) / 2
    known = _Truth(truth.mr_from_tracker_at(0.0), truth.targets.points, center)
    start = _start(known, disturbed, rng)
    return _Registered(register_scenario(scenario, start, seed=seed).result, start, known, drawn)


def _start(known: KnownTruth, disturbed: bool, rng: np.random.Generator) -> Rigid:
    return start_with_error(known, float(rng.uniform(*(DISTURBED_START_MM if disturbed else START_MM))), rng)


def _disturbed(preset: Preset, rng: np.random.Generator) -> tuple[Preset, dict[str, float]]:
    """The preset with errors drawn from the ranges above, and what was drawn."""
    drawn = {
        "sweep_s": float(rng.uniform(*DISTURBED_SWEEP_S)),
        "mismatch_mm": float(rng.uniform(*DISTURBED_MISMATCH_MM)),
        "probe_mm": float(rng.uniform(*DISTURBED_PROBE_MM)),
        "ecg_late_s": float(rng.uniform(*DISTURBED_LATENCY_S)),
    }
    ecg = replace(preset.ecg, latency_s=drawn["ecg_late_s"])
    changed = replace(
        preset,
        mismatch_mm=drawn["mismatch_mm"],
        other_probe_mm=drawn["probe_mm"],
        ecg=ecg,
        other_probe_deg=0.0,
    )
    return changed, drawn


def _untouched(scenario: Scenario) -> Scenario:
    """The recording without landmarks: what is judged is what the images say."""
    return replace(scenario, landmarks_mr=None, landmarks_tracker=None)


def _volumes(seed: int, quality: str, disturbed: bool, rng: np.random.Generator) -> _Registered:
    motion: Any = MOTION[seed % 2]
    named: Any = quality
    change: Any = str(rng.choice(["none", "deformation", "motion"])) if disturbed else "none"
    late = float(rng.uniform(0.0, 0.06)) if disturbed else 0.0
    pair = image_pair(PairSpec(seed, motion, named, change, VARIED))
    problem = volume_problem(pair, pair.volumes(GATED, phase_error=late))
    start = _start(problem, disturbed, rng)
    result = problem.register(start, np.random.default_rng(seed))
    return _Registered(result, start, problem, {"gate_late": late})


def _measured(done: _Registered) -> Line:
    """Errors at the targets, and what the result says of itself."""
    result = done.result
    errors = target_errors_mm(result.target_from_source, done.known.truth, done.known.targets)
    return {
        "start_mm": float(target_errors_mm(done.start, done.known.truth, done.known.targets).mean()),
        "tre_mm": float(errors.mean()),
        "tre_p95_mm": float(np.percentile(errors, 95)),
        "tre_max_mm": float(errors.max()),
        "chi2": _chi2(result, done.known.truth),
        "stop": result.stop.name,
        "usable": result.stop.usable,
        "success_probability": result.success_probability,
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
