"""Levels of leads: no signal, however large, small or silent, ends them."""

import numpy as np
import pytest

from dvf_ig.cardiac.lead_levels import LEAST_LEVEL, LeadLevels
from dvf_ig.cardiac.rpeak import RPeakDetector
from dvf_ig.core import InvalidInputError
from dvf_ig.core.plausible import ECG_VALUE


@pytest.mark.parametrize("value", [1e200, -1e300, 2 * ECG_VALUE])
def test_values_that_no_ecg_has_are_refused(value: float) -> None:
    detector = RPeakDetector(250.0)
    with pytest.raises(InvalidInputError, match="an ECG sample reaches"):
        detector.push(np.array([[0.0], [value]]), 0.0)


@pytest.mark.parametrize("value", [ECG_VALUE, 0.0, 1e-300, np.nan, np.inf])
def test_a_sample_at_the_limit_ends_nothing(value: float) -> None:
    """In the first two seconds, when levels are learnt, and later."""
    detector, rng = RPeakDetector(250.0, 2), np.random.default_rng(1)
    samples = rng.normal(0.0, 0.01, (2500, 2))
    samples[::200] += 1.0
    samples[[100, 1500]] = value
    for first in range(0, len(samples), 50):
        detector.push(samples[first : first + 50], first / 250.0)


def test_levels_of_a_lead_without_complexes_fall_no_lower_than_the_least() -> None:
    levels = LeadLevels(250.0, 1, 2.5)
    levels.learn(np.full((500, 1), 1e-6), 250.0, [False])
    for _ in range(10_000):
        levels.combined([0.0], [False])
        levels.follow([0.0])
        levels.decay()
    assert levels._level == [LEAST_LEVEL]
    assert np.isfinite(levels.combined([1.0], [False]))
