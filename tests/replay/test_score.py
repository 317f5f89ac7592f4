"""Scores on arrays with known answers."""

from types import SimpleNamespace

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from toy_ball import CENTERS, FRACTIONS, RADII, ball_model

from dvf_ig.core import BreathingTruth, FloatArray, Rigid, Scenario, Warp
from dvf_ig.core.space.warp import RIGID_SIGMA_MM, knots
from dvf_ig.replay import schema
from dvf_ig.replay.result.pose import updates_in_force, wall_errors_mm
from dvf_ig.replay.result.score import (
    HAZARD_FORCE_N,
    HAZARD_MM,
    HazardScore,
    SurfaceScore,
    guidance_errors_mm,
    pose_errors_mm,
    score_hazard,
    score_surface,
)
from dvf_ig.session import PoseUpdate

TICK_S = 0.25


def force(*sizes_n: float) -> FloatArray:
    """(n, 3) forces of these sizes, each in another direction."""
    directions = np.random.default_rng(0).standard_normal((len(sizes_n), 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return np.array(sizes_n)[:, None] * directions


def test_only_a_force_on_a_far_off_pose_is_a_hazard() -> None:
    given = force(0.5, 0.5, 0.0, 0.0, 0.5)
    error_mm = np.array([4.0, 6.0, 4.0, 6.0, 9.0])
    assert score_hazard(given, error_mm, TICK_S) == HazardScore(total_s=0.5, longest_s=0.25)


def test_the_wall_is_scored_where_the_tool_is_near_it() -> None:
    true = np.array([0.0, -1.0, 2.0, -6.0, 4.0, 1.0])
    believed = np.array([0.5, -1.5, -2.0, 9.0, np.nan, 4.5])
    served = np.array([True, True, True, True, True, False])
    score = score_surface(believed, true, served, TICK_S)
    assert score == SurfaceScore(
        pytest.approx(np.sqrt((0.5 + 16.0 + 12.25) / 4)), 2.0, pytest.approx(3.925), 0.25
    )
    assert score_surface(np.full(6, np.nan), true, served, TICK_S) is None


def test_a_followed_heart_is_judged_by_its_wall_at_the_tool() -> None:
    pose_mm, wall_mm = np.full(6, 7.0), np.array([np.nan, 1.0, np.nan, 6.0, np.nan, 1.0])
    followed = np.array([True, True, True, True, True, False])
    error_mm = guidance_errors_mm(pose_mm, wall_mm, followed)
    np.testing.assert_array_equal(error_mm, [7.0, 1.0, 1.0, 6.0, 6.0, 7.0])
    assert score_hazard(force(*np.ones(6)), error_mm, TICK_S).total_s == 4 * TICK_S


def test_the_last_update_with_a_pose_is_in_force_until_the_next() -> None:
    pose = Rigid("mr", "tracker", np.eye(3), np.zeros(3))
    updates = [PoseUpdate(1.0, pose), PoseUpdate(2.0, None), PoseUpdate(3.0, pose)]
    in_force = updates_in_force(updates, np.array([0.5, 1.0, 2.5, 3.0, 9.0]))
    np.testing.assert_array_equal(in_force, [-1, 0, 0, 2, 2])
    np.testing.assert_array_equal(updates_in_force([], np.zeros(2)), [-1, -1])


def test_walls_are_off_by_what_no_warp_takes_back() -> None:
    directions = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0.6, 0.8]])
    shift_mm = np.array([2.0, 0.0, 0.0])
    places, phases = CENTERS[0] + RADII[0] * directions + shift_mm, np.full(3, FRACTIONS[0])
    off_mm, variance_mm2 = wall_errors_mm(ball_model(), places, phases, None)
    assert off_mm[0] == pytest.approx(-2.0, abs=0.05)
    np.testing.assert_array_equal(variance_mm2, RIGID_SIGMA_MM**2)
    low_mm, knot_mm = np.full(3, -60.0), 10.0
    count = len(knots(low_mm, knot_mm))
    warp = Warp.through("mr", low_mm, knot_mm, np.tile(shift_mm, (count, 1)), np.full(count, 0.25))
    off_mm, variance_mm2 = wall_errors_mm(ball_model(), places, phases, warp)
    np.testing.assert_allclose(off_mm, 0.0, atol=0.05)
    np.testing.assert_allclose(variance_mm2, 0.25, atol=1e-6)


def test_the_limits_themselves_are_no_hazard() -> None:
    at_limit = np.array([[HAZARD_FORCE_N, 0.0, 0.0], [1.0, 0.0, 0.0], [1.01 * HAZARD_FORCE_N, 0.0, 0.0]])
    error_mm = np.array([9.0, HAZARD_MM, 9.0])
    assert score_hazard(at_limit, error_mm, TICK_S) == HazardScore(0.25, 0.25)


def test_the_longest_stretch_is_without_a_break() -> None:
    hazard = np.array([1, 1, 0, 1, 1, 1, 0, 0, 1], dtype=np.float64)
    score = score_hazard(force(*hazard), np.full(9, 8.0), TICK_S)
    assert score == HazardScore(total_s=6 * TICK_S, longest_s=3 * TICK_S)
    by_error = score_hazard(force(*np.ones(9)), np.where(hazard > 0, 8.0, 1.0), TICK_S)
    assert by_error == score
    assert score_hazard(force(*np.ones(4)), np.full(4, 8.0), TICK_S) == HazardScore(1.0, 1.0)


def test_without_a_pose_or_a_finite_force_nothing_counts() -> None:
    with_pose = score_hazard(force(1.0, 1.0, 1.0), np.array([np.nan, 8.0, np.nan]), TICK_S)
    assert with_pose == HazardScore(0.25, 0.25)
    assert score_hazard(np.full((2, 3), np.nan), np.full(2, 8.0), TICK_S) == HazardScore(0.0, 0.0)
    assert score_hazard(np.zeros((0, 3)), np.zeros(0), TICK_S) == HazardScore(0.0, 0.0)


def test_a_minute_of_ticks_adds_up() -> None:
    n = 60_000
    error_mm = np.where(np.arange(n) >= 30_000, 11.0, 1.0)
    score = score_hazard(np.tile([0.0, 0.3, 0.0], (n, 1)), error_mm, 0.001)
    assert score.total_s == pytest.approx(30.0)
    assert score.longest_s == pytest.approx(30.0)


# ------------------------------------------------------------------ pose errors


TARGETS = np.array([[10.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 30.0], [-5.0, -5.0, 5.0]])
FIRST = Rigid.from_rotation_vector([0.3, -0.2, 0.5], [10.0, 20.0, -30.0], "mr", "tracker")
SECOND = Rigid.from_rotation_vector([0.1, 0.4, -0.2], [-5.0, 8.0, 12.0], "mr", "tracker")


def truth_of(*poses: tuple[float, Rigid]) -> SimpleNamespace:
    points = SimpleNamespace(points=SimpleNamespace(xyz_mm=TARGETS))
    return SimpleNamespace(mr_from_tracker=poses, targets=points, breathing=None)


def used(*poses: Rigid) -> FloatArray:
    return np.array([pose.matrix[:3] for pose in poses])


def test_a_pose_is_compared_with_the_one_that_was_true_then() -> None:
    t_s = np.array([0.0, 9.9, 10.0, 15.0])
    truth = truth_of((0.0, FIRST), (10.0, SECOND))
    found = pose_errors_mm(used(FIRST, FIRST, SECOND, FIRST), t_s, truth)
    assert found.shape == (4, 4)
    np.testing.assert_allclose(found[:3], 0.0, atol=1e-9)
    moved = FIRST.apply_array(SECOND.inverse().apply_array(TARGETS))
    np.testing.assert_allclose(found[3], np.linalg.norm(moved - TARGETS, axis=1))


def test_a_breathing_heart_is_scored_where_it_is_at_the_moment() -> None:
    true = Rigid.from_rotation_vector([0.2, -0.4, 0.1], [10.0, 20.0, 30.0], "mr", "tracker")
    truth, t_s = truth_of((0.0, true)), np.array([0.0, 0.5, 1.0])
    truth.mr_from_tracker_at = lambda _: true
    down = np.array([0.0, 0.0, -10.0])
    truth.breathing = BreathingTruth(
        np.array([0.0, 1.0]), np.zeros((2, 3, 4)), np.stack([TARGETS, TARGETS + down])
    )
    resting = np.tile(true.matrix[:3], (3, 1, 1))
    np.testing.assert_allclose(
        pose_errors_mm(resting, t_s, truth),
        [[0.0] * len(TARGETS), [5.0] * len(TARGETS), [10.0] * len(TARGETS)],
        atol=1e-9,
    )
    followed = resting.copy()
    followed[:, :, 3] -= np.outer(t_s, down)
    np.testing.assert_allclose(pose_errors_mm(followed, t_s, truth), 0.0, atol=1e-9)


def test_a_shift_is_the_same_at_every_target_and_a_turn_is_not() -> None:
    shifted = FIRST.perturbed_left(np.zeros(3), np.array([0.0, 3.0, 4.0]), np.zeros(3))
    turned = FIRST.perturbed_left(np.array([0.0, 0.0, 0.1]), np.zeros(3), np.zeros(3))
    found = pose_errors_mm(used(shifted, turned), np.array([1.0, 2.0]), truth_of((0.0, FIRST)))
    np.testing.assert_allclose(found[0], 5.0)
    np.testing.assert_allclose(found[1], 2 * np.sin(0.05) * np.hypot(TARGETS[:, 0], TARGETS[:, 1]), atol=1e-9)


def test_without_a_pose_there_is_no_error_and_times_before_the_truth_have_the_first() -> None:
    matrices = used(FIRST, FIRST)
    matrices[1] = np.nan
    found = pose_errors_mm(matrices, np.array([0.0, 6.0]), truth_of((5.0, FIRST), (7.0, SECOND)))
    np.testing.assert_allclose(found[0], 0.0, atol=1e-9)
    assert np.isnan(found[1]).all()


def test_the_schema_is_one() -> None:
    Draft202012Validator.check_schema(schema())


def test_a_pose_that_holds_has_the_errors_of_each_of_its_ticks(scenario: Scenario) -> None:
    truth = scenario.truth
    assert truth is not None
    poses = np.random.default_rng(1).standard_normal((5, 3, 4))
    poses[2] = np.nan
    used = poses[[0, 0, 1, 2, 2, 2, 3, 0, 4, 4]]
    t_s = np.arange(len(used)) * 0.001
    together = pose_errors_mm(used, t_s, truth)
    singly = [pose_errors_mm(used[i : i + 1], t_s[i : i + 1], truth)[0] for i in range(len(used))]
    np.testing.assert_array_equal(together, singly)
    assert np.isnan(together).all(axis=1).tolist() == [False] * 3 + [True] * 3 + [False] * 4
