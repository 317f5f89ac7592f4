"""Poses that change once, and occlusions: where and how much, exactly."""

import numpy as np
import pytest

from data_synth.operator.pose_path import composed, inverted
from data_synth.scenario.displacement import STEP_S, Displacement, displaced
from data_synth.signals.occlusion import OcclusionSpec, losses_in_contact
from dvf_ig.core import Rigid, ToolTruth


@pytest.mark.parametrize("over_s", [0.0, 0.5])
def test_the_steps_follow_the_motion(over_s: float) -> None:
    before = Rigid.from_rotation_vector([0.3, -0.2, 0.9], [5.0, 6.0, 7.0], "mr", "tracker")
    change = Displacement(0.25, 9.0, 5.0, over_s)
    center = np.array([40.0, 20.0, -10.0])
    pose = displaced(before, change, center, 40.0, np.random.default_rng(1))
    steps = pose.steps()
    assert steps[0] == (0.0, before)
    times = np.array([9.0, 10.0 + over_s + 1e-9, 30.0])
    rotations, translations = pose(times)
    np.testing.assert_allclose(translations[0], before.translation_mm, atol=1e-12)
    for i in (1, 2):
        np.testing.assert_allclose(rotations[i], steps[-1][1].rotation, atol=1e-9)
        np.testing.assert_allclose(translations[i], steps[-1][1].translation_mm, atol=1e-6)
    for start_s, held in steps[1:-1]:
        near = pose(np.array([start_s + 0.5 * STEP_S]))[1][0]
        assert np.linalg.norm(near - held.translation_mm) < 0.5


def test_ranges_are_drawn_and_a_fixed_change_stays_to_the_last_bit() -> None:
    ranged = Displacement(shift_mm=8.0, shift_up_to_mm=15.0, over_s=0.5, wait_s=(2.0, 10.0))
    drawn = [ranged.drawn(np.random.default_rng(seed)) for seed in range(200)]
    sizes, waits = np.array([d.shift_mm for d in drawn]), np.array([d.wait_s[0] for d in drawn])
    for values, low, high in ((sizes, 8.0, 15.0), (waits, 2.0, 10.0)):
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
    assert all(d.wait_s[0] == d.wait_s[1] for d in drawn)
    assert ranged.drawn(np.random.default_rng(5)) == ranged.drawn(np.random.default_rng(5))
    fixed = Displacement(0.25, 9.0, 5.0, 0.5)
    assert fixed.drawn(np.random.default_rng(1)) == fixed
    before = Rigid.identity("mr", "tracker")
    pose = displaced(before, drawn[0], np.zeros(3), 40.0, np.random.default_rng(1))
    assert pose.start_s == 20.0 + waits[0]
    assert np.linalg.norm(pose.shift_mm) == pytest.approx(sizes[0])


def test_losses_are_placed_in_contact() -> None:
    t_s = np.arange(0.0, 60.0, 0.001)
    distance = np.where((t_s > 20) & (t_s < 30), 1.0, -5.0)
    contact = ToolTruth(
        t_s, np.zeros((len(t_s), 3)), 0 * t_s, 0 * t_s, distance, np.tile([1.0, 0, 0], (len(t_s), 1))
    )
    for seed in range(20):
        losses = losses_in_contact(contact, OcclusionSpec(3.0), np.random.default_rng(seed))
        assert len(losses) == 3
        for start, stop in losses:
            assert 1.5 <= stop - start <= 4.0
            assert start < 30.0
            assert stop > 20.0
    assert losses_in_contact(contact, OcclusionSpec(), np.random.default_rng(0)) == ()


def test_paths_compose_and_invert_like_transforms() -> None:
    first = Rigid.from_rotation_vector([0.3, -0.2, 0.9], [5.0, 6.0, 7.0], "mr", "tracker")
    second = Rigid.from_rotation_vector([-0.7, 0.1, 0.2], [1.0, -2.0, 3.0], "tracker", "tool")
    none = Displacement()
    paths = [displaced(pose, none, np.zeros(3), 10.0, np.random.default_rng(0)) for pose in (first, second)]
    t_s = np.array([0.0, 4.0, 9.0])
    rotations, translations = composed(*paths)(t_s)
    np.testing.assert_allclose(rotations, np.tile((first @ second).rotation, (3, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(translations, np.tile((first @ second).translation_mm, (3, 1)), atol=1e-12)
    back = composed(inverted(paths[0]), paths[0])(t_s)
    np.testing.assert_allclose(back[0], np.tile(np.eye(3), (3, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(back[1], 0.0, atol=1e-12)
