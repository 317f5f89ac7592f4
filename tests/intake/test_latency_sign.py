"""A latency of the wrong sign is found by the probe's own motion, and a right one never called wrong."""

import numpy as np
import pytest

from dvf_ig.core import ImageMap, PoseStream, Rigid
from dvf_ig.intake.ecg_delay import ImageChange
from dvf_ig.intake.heart_in_images import REVERSED_LOG_RATIO, reversed_log_ratio

FRAME_S, SHAPE = 0.08, (80, 60)
IMAGE = ImageMap(Rigid.identity("probe", "image"), np.array([0.5, 0.5]))


def sweep(evenly: bool) -> PoseStream:
    """25 s of a hand along x at 15 mm/s, or between 5 and 25."""
    t_s = np.arange(0.0, 25.0, 0.02)
    uneven_mm = 0.0 if evenly else 1.0
    x_mm = 15.0 * t_s + uneven_mm * (4.0 * np.sin(1.7 * t_s) + 1.0 * np.sin(5.1 * t_s))
    shifts_mm = np.column_stack([x_mm, np.zeros((len(t_s), 2))])
    turns = np.tile(np.eye(3), (len(t_s), 1, 1))
    return PoseStream("tracker", "probe", t_s, turns, shifts_mm, np.ones(len(t_s), bool))


def changes(probe: PoseStream, lag_s: float, seed: int) -> ImageChange:
    """Images whose change follows the distance that the probe moved, with 20 % noise."""
    t_s = np.arange(0.5, 24.0, FRAME_S)
    ends_mm = [probe.at_many(t_s + lag_s + part * FRAME_S)[1][:, 0] for part in (-0.5, 0.5)]
    moved_mm = np.abs(ends_mm[1] - ends_mm[0])
    noise = np.random.default_rng(seed).normal(size=len(t_s))
    return ImageChange(t_s, np.sqrt(moved_mm) * np.exp(0.2 * noise), moved_mm, FRAME_S)


@pytest.mark.parametrize("lag_s", [-0.08, -0.04, 0.04, 0.08])
@pytest.mark.parametrize("seed", range(2))
def test_the_other_sign_is_found(lag_s: float, seed: int) -> None:
    probe = sweep(evenly=False)
    images = changes(probe, lag_s, seed)
    right, wrong = (reversed_log_ratio(images, probe, IMAGE, SHAPE, one) for one in (lag_s, -lag_s))
    assert right < 0.0
    assert right == pytest.approx(-wrong)
    assert abs(lag_s) < 0.08 or wrong > REVERSED_LOG_RATIO


@pytest.mark.parametrize("seed", range(2))
def test_an_even_sweep_and_a_small_latency_say_nothing(seed: int) -> None:
    even, uneven = sweep(evenly=True), sweep(evenly=False)
    assert abs(reversed_log_ratio(changes(even, 0.06, seed), even, IMAGE, SHAPE, -0.06)) < REVERSED_LOG_RATIO
    assert reversed_log_ratio(changes(uneven, 0.01, seed), uneven, IMAGE, SHAPE, -0.01) == 0.0
