"""One heart of a synthetic world, imaged and registered once from a coarse start, without landmarks."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from data_synth import (
    PRESETS,
    HeartSpec,
    PairSpec,
    Preset,
    ScenarioSpec,
    SecondWorldSpec,
    child_rng,
    image_pair,
    phantom_scenario,
    second_world_pair,
    second_world_scenario,
)
from dvf_ig.core import FloatArray, InvalidInputError, Points, Rigid, Scenario, read_only_arrays
from dvf_ig.registration import RegistrationResult
from dvf_ig.replay import register_scenario
from dvf_ig.session import build_heart, register_gated_volumes
from dvf_ig.study.registration.problem import GATED, volume_problem
from dvf_ig.study.registration.trial import KnownTruth, start_with_error
from dvf_ig.study.trials import Settings

VARIED = HeartSpec("varied")
"""Drawn from a population of healthy, dilated and hypertrophic hearts."""
MOTION = ("paper5mm", "physiological")
"""Of hearts with even and with odd numbers."""
SWEEP_S = 14.0
"""Length of a tracked sweep: what a session has seen when it registers first, and as much again."""
START_MM = (4.0, 12.0)
"""Mean error of the start over the targets, drawn evenly."""
DISTURBED_START_MM = (4.0, 50.0)
DISTURBED_SWEEP_S = (6.0, 14.0)
DISTURBED_MISMATCH_MM = (1.0, 5.0)
DISTURBED_PROBE_MM = (0.0, 2.0)
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
class RegisteredHeart:
    """A registration with its start, its truth, and what was drawn for it."""

    result: RegistrationResult
    start: Rigid
    known: KnownTruth
    drawn: dict[str, float]


def registered_heart(settings: Settings, seed: int) -> RegisteredHeart:
    """Make, image and register one heart.

    Args:
        settings: as `heart_trial`.
    Raises:
        InvalidInputError: a disturbed heart of the second world, which is never fitted to.
    """
    rng = child_rng(seed, "heart trial")
    quality, disturbed = settings["quality"], settings["disturbed"]
    if settings["world"] == "second":
        if disturbed:
            raise InvalidInputError("the second world is for reporting; its hearts are not disturbed further")
        second = {"sweep": _second_sweep, "volumes": _second_volumes}[settings["images"]]
        return second(SecondWorldSpec(seed, quality, _motion(seed), SWEEP_S), rng)
    first: Callable[..., RegisteredHeart] = {"sweep": _sweep, "volumes": _volumes}[settings["images"]]
    return first(seed, quality, disturbed, rng)


def _motion(seed: int) -> Any:
    return MOTION[seed % 2]


def _sweep(seed: int, quality: str, disturbed: bool, rng: np.random.Generator) -> RegisteredHeart:
    preset, drawn = PRESETS[quality], {"sweep_s": SWEEP_S}
    if disturbed:
        preset, drawn = _disturbed(preset, rng)
    spec = ScenarioSpec(quality, _motion(seed), drawn["sweep_s"], seed, changed=preset, heart=VARIED)
    return _registered_sweep(phantom_scenario(spec), seed, disturbed, rng, drawn)


def _second_sweep(spec: SecondWorldSpec, rng: np.random.Generator) -> RegisteredHeart:
    return _registered_sweep(second_world_scenario(spec), spec.seed, False, rng, {"sweep_s": spec.seconds})


def _registered_sweep(
    touched: Scenario, seed: int, disturbed: bool, rng: np.random.Generator, drawn: dict[str, float]
) -> RegisteredHeart:
    """Without landmarks: what is judged is what the images say."""
    scenario = replace(touched, landmarks_mr=None, landmarks_tracker=None)
    truth = scenario.truth
    if truth is None:
        raise TypeError("a synthetic scenario has its truth")
    box = truth.surface.vertices_mm[0]
    center = (box.min(axis=0) + box.max(axis=0)) / 2
    known = _Truth(truth.mr_from_tracker_at(0.0), truth.targets.points, center)
    start = _start(known, disturbed, rng)
    return RegisteredHeart(register_scenario(scenario, start, seed=seed).result, start, known, drawn)


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


def _volumes(seed: int, quality: str, disturbed: bool, rng: np.random.Generator) -> RegisteredHeart:
    named: Any = quality
    change: Any = str(rng.choice(["none", "deformation", "motion"])) if disturbed else "none"
    late = float(rng.uniform(0.0, 0.06)) if disturbed else 0.0
    pair = image_pair(PairSpec(seed, _motion(seed), named, change, VARIED))
    problem = volume_problem(pair, pair.volumes(GATED, phase_error=late))
    start = _start(problem, disturbed, rng)
    result = problem.register(start, np.random.default_rng(seed))
    return RegisteredHeart(result, start, problem, {"gate_late": late})


def _second_volumes(spec: SecondWorldSpec, rng: np.random.Generator) -> RegisteredHeart:
    pair = second_world_pair(spec)
    known = _Truth(pair.mr_from_tracker, pair.targets.points, pair.center_mm)
    start = _start(known, False, rng)
    result = register_gated_volumes(
        pair.volumes(GATED),
        build_heart(pair.preop),
        start,
        mr=pair.preop.mr,
        seed=spec.seed,
        clock=perf_counter,
    )
    return RegisteredHeart(result, start, known, {})
