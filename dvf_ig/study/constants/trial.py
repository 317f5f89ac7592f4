"""One trial: tuning hearts registered with one constant larger or smaller than it is."""

from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter

import numpy as np

from data_synth import HeartSpec, ScenarioSpec, child_rng, phantom_scenario
from dvf_ig.core import DvfIgError, Points, Rigid
from dvf_ig.registration import target_errors_mm
from dvf_ig.replay import register_scenario
from dvf_ig.session import UltrasoundRecording, gate_recording, register_frames
from dvf_ig.study.hearts.lists import TUNING
from dvf_ig.study.trials import Line, Settings

from .listing import Constant, registration_constants
from .varied import varied

FACTORS = (0.7, 1.3)
SWEEP_S = 14.0
QUALITIES = ("calm", "poor-image")


@dataclass(frozen=True, slots=True, eq=False)
class _Recorded:
    """A tuning heart's sweep, its coarse start and its truth."""

    recording: UltrasoundRecording
    start: Rigid
    truth: Rigid
    targets: Points


ELSEWHERE = (
    "pair",
    "surface_points.",
    "tracking.",
    "session.beat",
    "session.conf",
    "session.pose",
    "session.regis",
)
"""Beginnings of labels of constants that do not act in the registration of a sweep, and are not varied."""


def varied_constants() -> list[Constant]:
    """Those that the trials vary."""
    return [constant for constant in registration_constants() if not constant.label.startswith(ELSEWHERE)]


def trial_numbers(constants: int) -> range:
    """Numbers of the trials: each constant smaller, then larger; the last one leaves all as they are."""
    return range(len(FACTORS) * constants + 1)


def constant_trial(settings: Settings, number: int) -> Line:
    """Register the tuning hearts with one constant changed.

    Args:
        settings: `hearts`, how many tuning hearts.
        number: one of `trial_numbers`.
    """
    constants = varied_constants()
    place, which = divmod(number, len(FACTORS))
    if place == len(constants):
        return {"constant": "", "factor": 1.0, **_measured(settings["hearts"])}
    constant: Constant = constants[place]
    with varied(constant, FACTORS[which]) as value:
        found = _measured(settings["hearts"])
    return {"constant": constant.label, "factor": FACTORS[which], "value": value, **found}


def _measured(hearts: int) -> Line:
    """Mean errors of all hearts, and which poses were refused."""
    errors: list[float | None] = []
    refused = 0
    began = perf_counter()
    for recorded in _recordings(hearts):
        try:
            frames = gate_recording(recorded.recording, from_s=-np.inf, until_s=np.inf)
            result = register_frames(recorded.recording, frames, recorded.start, seed=0, clock=perf_counter)
        except DvfIgError:
            errors.append(None)
            refused += 1
            continue
        pose = result.target_from_source
        errors.append(float(target_errors_mm(pose, recorded.truth, recorded.targets).mean()))
        refused += not result.stop.usable
    return {"tre_mm": errors, "refused_n": refused, "seconds": perf_counter() - began}


@lru_cache(maxsize=1)
def _recordings(hearts: int) -> tuple[_Recorded, ...]:
    return tuple(_recorded(seed, quality) for seed in TUNING.first_world[:hearts] for quality in QUALITIES)


def _recorded(seed: int, quality: str) -> _Recorded:
    spec = ScenarioSpec(quality, "paper5mm", SWEEP_S, seed, heart=HeartSpec("varied"))
    scenario = replace(phantom_scenario(spec), landmarks_mr=None, landmarks_tracker=None)
    truth = scenario.truth
    if truth is None:
        raise TypeError("a synthetic scenario has its truth")
    true_pose = truth.mr_from_tracker_at(0.0)
    rng = child_rng(seed, "constants")
    turn, shift = rng.normal(size=3), rng.normal(size=3)
    center = truth.targets.points.xyz_mm.mean(axis=0)
    start = true_pose.perturbed_left(
        np.radians(6.0) * turn / np.linalg.norm(turn), 8.0 * shift / np.linalg.norm(shift), center
    )
    done = register_scenario(scenario, start)
    return _Recorded(done.recording, start, true_pose, truth.targets.points)
