"""One heart of a synthetic world, imaged and registered once from a coarse start, without landmarks."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np

from data_synth import (
    PRESETS,
    HeartSpec,
    ImagedHeart,
    PairSpec,
    Preset,
    ScenarioSpec,
    SecondWorldSpec,
    child_rng,
    image_pair,
    imaged_heart,
    phantom_scenario,
    second_world_pair,
    second_world_recording,
)
from dvf_ig.core import FloatArray, InvalidInputError, Points, Rigid, Scenario, read_only_arrays
from dvf_ig.registration import RegistrationResult
from dvf_ig.replay import register_scenario
from dvf_ig.session import Heart, build_heart, register_gated_volumes
from dvf_ig.study.registration.problem import GATED, volume_problem
from dvf_ig.study.registration.trial import KnownTruth, start_with_error
from dvf_ig.study.trials import Settings

from .conditions import Condition, of_trial

VARIED = HeartSpec("varied")
"""Drawn from a population of healthy, dilated and hypertrophic hearts."""
MOTION = ("paper5mm", "physiological")
"""Of hearts with even and with odd numbers."""
SWEEP_S = 14.0
"""Length of a tracked sweep: what a session has seen when it registers first, and as much again."""
START_MM = (4.0, 12.0)
"""Mean error of the start over the targets, drawn evenly."""
DISTURBED_START_MM = (4.0, 50.0)
START_OF = {False: START_MM, True: DISTURBED_START_MM}
DISTURBED_SWEEP_S = (6.0, 14.0)
DISTURBED_MISMATCH_MM = (1.0, 5.0)
DISTURBED_PROBE_MM = (0.0, 2.0)
DISTURBED_LATENCY_S = (0.0, 0.06)
"""Ranges from which disturbed trials draw, evenly: they make the errors between good and lost that a stated
probability is fitted to."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true mr_from_tracker, where errors are declared, and a centre (3,) to turn about."""

    truth: Rigid
    targets: Points
    center_mm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredHeart:
    """A registration with its start, its truth, and what was drawn for it.

    Attributes:
        floor_mm: mean error at the targets of the pose that fits every point of the heart in the images to
            its own place in the MR: what no rigid registration removes. None in the first world, which does
            not tell it.
    """

    result: RegistrationResult
    start: Rigid
    known: KnownTruth
    drawn: dict[str, float]
    floor_mm: float | None = None


def registered_heart(settings: Settings, number: int) -> RegisteredHeart:
    """Make, image and register one heart.

    Args:
        settings: as `heart_trial`.
        number: of the trial.
    Raises:
        InvalidInputError: a disturbed heart of the second world, which is never fitted to.
    """
    seed, condition = of_trial(number, settings)
    if settings["world"] == "second":
        if condition.disturbed:
            raise InvalidInputError("the second world is for reporting; its hearts are not disturbed further")
        rng = child_rng(seed, "heart trial")
        quality: Any = condition.quality
        second = {"sweep": _second_sweep, "volumes": _second_volumes}[settings["images"]]
        return second(SecondWorldSpec(seed, quality, _motion(seed), SWEEP_S), rng)
    drawing = seed if condition.draw == 0 else number
    rng = child_rng(drawing, "heart trial")
    first: Callable[..., RegisteredHeart] = {"sweep": _sweep, "volumes": _volumes}[settings["images"]]
    return first(seed, drawing, condition, rng)


def _motion(seed: int) -> Any:
    return MOTION[seed % 2]


@lru_cache(maxsize=1)
def _prepared(seed: int) -> tuple[ImagedHeart, Heart]:
    """A heart of the first world with what is made of its pre-operative images, for all its trials."""
    imaged = imaged_heart(ScenarioSpec(motion=_motion(seed), seed=seed, heart=VARIED))
    return imaged, build_heart(imaged.preop)


def _sweep(seed: int, drawing: int, condition: Condition, rng: np.random.Generator) -> RegisteredHeart:
    """The probe's path, speckle and rhythm of disturbed recordings are drawn anew, the heart is not."""
    imaged, heart = _prepared(seed)
    preset, drawn = PRESETS[condition.quality], {"sweep_s": SWEEP_S}
    if condition.disturbed:
        preset, drawn = _disturbed(preset, rng)
    same = replace(VARIED, anatomy_seed=seed, motion_seed=seed)
    spec = ScenarioSpec(
        condition.quality, _motion(seed), drawn["sweep_s"], drawing, changed=preset, heart=same
    )
    scenario = phantom_scenario(spec, imaged=imaged)
    return _registered_sweep(scenario, heart, seed, START_OF[condition.disturbed], rng, drawn)


def _second_sweep(spec: SecondWorldSpec, rng: np.random.Generator) -> RegisteredHeart:
    made = second_world_recording(spec)
    heart = build_heart(made.scenario.preop)
    done = _registered_sweep(made.scenario, heart, spec.seed, START_MM, rng, {"sweep_s": spec.seconds})
    return replace(done, floor_mm=made.floor.pose_mm)


def _registered_sweep(
    touched: Scenario,
    heart: Heart,
    seed: int,
    start_mm: tuple[float, float],
    rng: np.random.Generator,
    drawn: dict[str, float],
) -> RegisteredHeart:
    """Without landmarks: what is judged is what the images say."""
    scenario = replace(touched, landmarks_mr=None, landmarks_tracker=None)
    truth = scenario.truth
    if truth is None:
        raise TypeError("a synthetic scenario has its truth")
    box = truth.surface.vertices_mm[0]
    center = (box.min(axis=0) + box.max(axis=0)) / 2
    known = Truth(truth.mr_from_tracker_at(0.0), truth.targets.points, center)
    start = start_with_error(known, float(rng.uniform(*start_mm)), rng)
    result = register_scenario(scenario, start, heart=heart, seed=seed)
    return RegisteredHeart(result, start, known, drawn)


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


def _volumes(seed: int, drawing: int, condition: Condition, rng: np.random.Generator) -> RegisteredHeart:
    named: Any = condition.quality
    change: Any = str(rng.choice(["none", "deformation", "motion"])) if condition.disturbed else "none"
    late = float(rng.uniform(0.0, 0.06)) if condition.disturbed else 0.0
    same = replace(VARIED, anatomy_seed=seed, motion_seed=seed)
    pair = image_pair(PairSpec(drawing, _motion(seed), named, change, same))
    problem = volume_problem(pair, pair.volumes(GATED, phase_error=late))
    start = start_with_error(problem, float(rng.uniform(*START_OF[condition.disturbed])), rng)
    result = problem.register(start, np.random.default_rng(seed))
    return RegisteredHeart(result, start, problem, {"gate_late": late})


def _second_volumes(spec: SecondWorldSpec, rng: np.random.Generator) -> RegisteredHeart:
    pair = second_world_pair(spec)
    known = Truth(pair.mr_from_tracker, pair.targets.points, pair.center_mm)
    start = start_with_error(known, float(rng.uniform(*START_MM)), rng)
    result = register_gated_volumes(
        pair.volumes(GATED),
        build_heart(pair.preop),
        start,
        mr=pair.preop.mr,
        seed=spec.seed,
        clock=perf_counter,
    )
    return RegisteredHeart(result, start, known, {}, pair.floor.pose_mm)
