"""A registration problem whose every registration ends at the same distance from the truth."""

from dataclasses import replace
from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import InvalidInputError, Points, Rigid, Stop
from dvf_ig.registration import (
    HeartChannels,
    Level,
    RegistrationOptions,
    RegistrationResult,
    UltrasoundImages,
    channels_from_mr,
    register,
)
from dvf_ig.study.registration.problem import RegistrationProblem

TARGETS = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-45, 45, (27, 3)))
OFFSET_MM = 0.7


@lru_cache(maxsize=1)
def any_result() -> RegistrationResult:
    """A registration of the toy heart: what the stub's results say besides their pose."""
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.1)
    level, channels = Level(slices, 3.0), channels_from_mr(toy_mr(), smoothing_mm=3.0)
    images = UltrasoundImages(level, level, options=RegistrationOptions(starts=1))
    heart = HeartChannels(channels, CENTER_MM)
    return register(images, heart, toy_pose(), rng=np.random.default_rng(0), clock=perf_counter)


def stub_problem(pair: int, condition: dict[str, Any]) -> RegistrationProblem:
    """Registration that always ends OFFSET_MM from the truth, and refuses starts of the pair 13."""

    def solve(start: Rigid, rng: np.random.Generator) -> RegistrationResult:
        if pair == 13:
            raise InvalidInputError("pair 13 is refused")
        off = toy_pose().perturbed_left([0, 0, 0], [0.0, OFFSET_MM, 0.0], CENTER_MM)
        found = any_result()
        evidence = replace(found.evidence, split_half_mm=np.inf)
        return replace(found, target_from_source=off, stop=Stop.CONVERGED, evidence=evidence)

    return RegistrationProblem(toy_pose(), TARGETS, CENTER_MM, solve)
