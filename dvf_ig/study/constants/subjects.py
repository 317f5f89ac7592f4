"""What a constant is tried on: registrations of tuning hearts and of tuning brains whose truth is known."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache, partial
from time import perf_counter
from typing import Any

import numpy as np

from data_synth import PairSpec, ScenarioSpec, child_rng, image_pair, phantom_scenario
from data_synth.organ_pair.pair import displaced_start, organ_pair
from dvf_ig.core import Rigid
from dvf_ig.registration import RegistrationResult, register_pair, target_errors_mm
from dvf_ig.replay.registration import recorded_ultrasound
from dvf_ig.session import (
    build_heart,
    gate_recording,
    register_frames,
    register_gated_volumes,
)
from dvf_ig.study.hearts.lists import TUNING
from dvf_ig.study.hearts.registered import VARIED, Truth
from dvf_ig.study.registration.problem import GATED
from dvf_ig.study.registration.trial import start_with_error

from .listing import Constant


class Subject(StrEnum):
    """Kind of registration that a constant acts in."""

    sweep = "sweep"
    volumes = "volumes"
    pair = "pair"


QUALITIES, CONTRASTS = ("calm", "poor-image"), ("t1", "flair")
"""Each heart is imaged twice, each brain has two kinds of MR."""
SWEEP_S = 14.0
START_MM = 8.0
"""Mean error of every start over the targets."""

PREPARING = ("session.heart.", "boundary.target.")
"""Beginnings of labels of constants that act where a heart is prepared: it is prepared anew with each."""
_ELSEWHERE = (
    "pairs.check.PARTS",
    "surface_points.",
    "boundary.options.EPICARDIUM_FIT.",
    "lc2.channels.",
    "flipped_axes.",
    "start.",
    "tracking.",
    "result.",
    "evidence.assessment.Assessment.",
    "evidence.checks.IMAGE_LIMITS.",
    "evidence.checks.Limits.",
    "session.pose.",
    "session.ultrasound.beat_evaluation.",
    "session.heart.LABEL_",
)
"""Of constants that act in none of these: touched points, beats, the watch over a pose, models without MR or
without chambers, numbers that name labels or octants."""
_IN_PAIRS = ("pairs.", "evidence.pair_evidence.", "lc2.volume_lc2.")
_IN_VOLUMES = ("volumes.", "evidence.checks.VOLUME_LIMITS.")

Register = Callable[[bool], RegistrationResult]
"""One registration; True prepares the heart anew."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One registration with known truth.

    Attributes:
        register: see Register.
        error_mm: of a pose, mean over the targets.
    """

    register: Register
    error_mm: Callable[[Rigid], float]


def subject_of(constant: Constant) -> Subject | None:
    """What the constant is tried on; None where it acts in none of them."""
    if constant.label.startswith(_ELSEWHERE):
        return None
    if constant.label.startswith(_IN_PAIRS):
        return Subject.pair
    return Subject.volumes if constant.label.startswith(_IN_VOLUMES) else Subject.sweep


@lru_cache(maxsize=1)
def cases_of(subject: Subject, count: int) -> tuple[Case, ...]:
    """The registrations of the first `count` hearts, or brains, of the tuning list."""
    make, variants = _MAKERS[subject]
    return tuple(make(seed, variant) for seed in TUNING.first_world[:count] for variant in variants)


def _sweep(seed: int, quality: str) -> Case:
    """A tracked sweep, without landmarks."""
    spec = ScenarioSpec(quality, "paper5mm", SWEEP_S, seed, heart=VARIED)
    scenario = replace(phantom_scenario(spec), landmarks_mr=None, landmarks_tracker=None)
    truth = scenario.truth
    if truth is None:
        raise TypeError("a synthetic scenario has its truth")
    targets = truth.targets.points
    known = Truth(truth.mr_from_tracker_at(0.0), targets, targets.xyz_mm.mean(axis=0))
    start = start_with_error(known, START_MM, child_rng(seed, "constants"))
    recording = recorded_ultrasound(replace(scenario, start=start))

    def register(anew: bool) -> RegistrationResult:
        heart = build_heart(scenario.preop, recording.heart.model) if anew else recording.heart
        used = replace(recording, heart=heart)
        frames = gate_recording(used, from_s=-np.inf, until_s=np.inf)
        return register_frames(used, frames, start, seed=0, clock=perf_counter)

    return Case(register, partial(_error_mm, known))


def _volumes(seed: int, quality: Any) -> Case:
    """Gated 3-D images."""
    pair = image_pair(PairSpec(seed, "paper5mm", quality, heart=VARIED))
    known = Truth(pair.mr_from_tracker, pair.targets.points, pair.center_mm)
    start = start_with_error(known, START_MM, child_rng(seed, "constants"))
    volumes, heart, mr = pair.volumes(GATED), build_heart(pair.preop), pair.preop.mr

    def register(_: bool) -> RegistrationResult:
        return register_gated_volumes(volumes, heart, start, mr=mr, seed=0, clock=perf_counter)

    return Case(register, partial(_error_mm, known))


def _pair(seed: int, contrast: str) -> Case:
    """Ultrasound and MR of a simulated brain."""
    pair = organ_pair(seed)
    start = displaced_start(pair, START_MM, child_rng(seed, "constants"))

    def register(_: bool) -> RegistrationResult:
        rng = np.random.default_rng(0)
        return register_pair(pair.fixed, [pair.moving[contrast]], start, rng=rng, clock=perf_counter)

    return Case(register, pair.error_mm)


def _error_mm(known: Truth, pose: Rigid) -> float:
    return float(target_errors_mm(pose, known.truth, known.targets).mean())


_MAKERS: dict[Subject, tuple[Callable[[int, str], Case], tuple[str, ...]]] = {
    Subject.sweep: (_sweep, QUALITIES),
    Subject.volumes: (_volumes, QUALITIES),
    Subject.pair: (_pair, CONTRASTS),
}
