"""One beat's slices tell a good pose from a wrong one, and a filter over beats follows a slow drift."""

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import Rigid
from dvf_ig.registration import (
    HEART_RADIUS_MM,
    BeatLook,
    Belief,
    Lc2,
    PoseChart,
    channels_from_mr,
    distance_between,
    look_at_beat,
)
from dvf_ig.registration.tracking.pose_estimate import WANDER_MM

MR = toy_mr()
MODEL = channels_from_mr(MR, smoothing_mm=2.0)
TRUTH = toy_pose()
BEAT = np.arange(6)


def beat(pose: Rigid, seed: int, *, first: int = 0) -> Lc2:
    """Six of twelve slices through a heart that lies at `pose`."""
    slices = toy_slices(MR, pose, np.random.default_rng(seed), pitch_mm=3.0, speckle=0.05)
    return Lc2(slices.subset((first + 2 * BEAT) % 12), MODEL, patch_mm=13.0, pitch_mm=3.0)


def belief(pose: Rigid, sigma_mm: float) -> Belief:
    return Belief(pose, sigma_mm**2 * np.eye(6), CENTER_MM)


def test_fusing_one_coordinate_is_the_scalar_kalman_filter() -> None:
    information = np.zeros((6, 6))
    information[4, 4] = 1 / 0.8**2
    fused = belief(TRUTH, 0.6).fused(information @ np.full(6, 2.0), information)
    gain = 0.6**2 / (0.6**2 + 0.8**2)
    offset = PoseChart(TRUTH, CENTER_MM).coordinates(fused.pose)
    np.testing.assert_allclose(offset, [0, 0, 0, 0, 2.0 * gain, 0], atol=1e-9)
    np.testing.assert_allclose(
        np.diag(fused.covariance_mm2), [0.36, 0.36, 0.36, 0.36, 0.36 * (1 - gain), 0.36]
    )


def test_two_beliefs_meet_between_whichever_comes_first() -> None:
    second = belief(PoseChart(TRUTH, CENTER_MM).pose(np.array([0.5, 0, -0.4, 1.0, -0.8, 0.3])), 0.5)
    there, back = belief(TRUTH, 1.0).fused_with(second), second.fused_with(belief(TRUTH, 1.0))
    assert distance_between(there.pose, back.pose, CENTER_MM) < 0.01
    assert distance_between(there.pose, second.pose, CENTER_MM) == pytest.approx(
        0.2 * distance_between(TRUTH, second.pose, CENTER_MM), rel=0.02
    )
    assert there.sigma_mm() == pytest.approx(np.sqrt(0.2))


def test_a_belief_ages_and_takes_a_registrations_units() -> None:
    covariance = np.diag([0.01**2] * 3 + [0.4**2] * 3)
    registered = Belief.registered(TRUTH, covariance, CENTER_MM)
    expected = [(0.01 * HEART_RADIUS_MM) ** 2] * 3 + [0.4**2] * 3
    np.testing.assert_allclose(np.diag(registered.covariance_mm2), expected)
    older = registered.aged(9.0)
    np.testing.assert_allclose(np.diag(older.covariance_mm2), np.array(expected) + 9 * WANDER_MM**2)
    assert older.pose is TRUTH


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_beat_tells_a_good_pose_from_a_wrong_one(seed: int) -> None:
    metric = beat(TRUTH, seed)
    good = look_at_beat(metric, TRUTH, CENTER_MM)
    wrong_pose = TRUTH.perturbed_left([0.04, -0.03, 0.02], [5.0, -4.0, 4.0], CENTER_MM)
    wrong = look_at_beat(metric, wrong_pose, CENTER_MM)
    assert good.moved_mm < 0.5
    assert good.surprise < 0.1
    assert distance_between(wrong.best, TRUTH, CENTER_MM) < 1.5
    assert wrong.surprise > 7.0
    assert np.linalg.eigvalsh(good.information).min() >= -1e-9


def test_offset_is_where_the_slices_would_have_the_pose() -> None:
    """With much of it known before, the belief stays; with nothing known, it goes to the climb's end."""
    start = TRUTH.perturbed_left([0.0, 0.0, 0.0], [3.0, 0.0, 0.0], CENTER_MM)
    look = look_at_beat(beat(TRUTH, 4), start, CENTER_MM)
    sure = belief(start, 0.01).fused(look.offset_information_mm, look.information)
    unsure = belief(start, 6.0).fused(look.offset_information_mm, look.information)
    assert distance_between(sure.pose, start, CENTER_MM) < 0.05
    assert distance_between(unsure.pose, look.best, CENTER_MM) < 0.5


def followed(drift_mm: np.ndarray, beats: int) -> tuple[Belief, Rigid, list[BeatLook]]:
    now, truth, looks = belief(TRUTH, 0.5), TRUTH, []
    for k in range(beats):
        truth = PoseChart(truth, CENTER_MM).pose(drift_mm)
        look = look_at_beat(beat(truth, 10 + k, first=k), now.pose, CENTER_MM)
        now = now.aged(1.0).fused(look.offset_information_mm, look.information)
        looks.append(look)
    return now, truth, looks


def test_a_slow_drift_is_followed_without_surprise() -> None:
    now, truth, looks = followed(np.array([0.05, 0.0, -0.05, 0.12, -0.1, 0.08]), 16)
    assert distance_between(TRUTH, truth, CENTER_MM) > 2.5
    assert distance_between(now.pose, truth, CENTER_MM) < 1.0
    assert max(look.surprise for look in looks) < 5.0


def test_beats_do_not_make_a_still_pose_noisier() -> None:
    now, truth, _ = followed(np.zeros(6), 12)
    assert distance_between(now.pose, truth, CENTER_MM) < 0.4
    assert now.sigma_mm() < 0.5
