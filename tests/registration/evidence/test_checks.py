"""Evidence of a pose: parts of the slices that are displaced by a known amount, on the toy heart."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import BoolArray, FloatArray, Rigid, mean_displacement_mm
from dvf_ig.registration import Lc2, PoseChart, RegistrationOptions, SliceSet, channels_from_mr
from dvf_ig.registration.evidence.checks import (
    IMAGE_LIMITS,
    SLICE_LIMITS,
    VOLUME_LIMITS,
    Evidence,
    PartDisagreements,
    half_space,
    part_disagreements,
    phase_groups,
    wrong_pose_z_score,
)
from dvf_ig.registration.lc2.slices import joined

MODEL = channels_from_mr(toy_mr(), smoothing_mm=3.0)
SLICES = joined(
    [
        toy_slices(toy_mr(), toy_pose(), np.random.default_rng(seed), pitch_mm=3.0, speckle=0.0)
        for seed in (0, 1)
    ]
)
PHASES = np.arange(24) * 7 % 24 / 24.0
"""Every slice at a phase of its own, in no order."""


def displaced(xi_mm: FloatArray) -> Rigid:
    return PoseChart(toy_pose(), CENTER_MM).pose(xi_mm)


def moved(part: BoolArray, pose: Rigid) -> SliceSet:
    """The slices, those of a part where the tracker would see them if the truth was `pose`."""
    step, maps = pose.inverse() @ toy_pose(), SLICES.frame_from_pixel.copy()
    maps[part] = step.rotation @ maps[part]
    maps[part, :, 2] += step.translation_mm
    return replace(SLICES, frame_from_pixel=maps)


def metric_of(slices: SliceSet) -> Lc2:
    return Lc2(slices, MODEL, patch_mm=13.0, pitch_mm=3.0)


def disagreements(slices: SliceSet) -> PartDisagreements:
    return part_disagreements(slices, metric_of, toy_pose(), CENTER_MM)


PHASED = replace(SLICES, model_phase=PHASES)


@pytest.mark.parametrize(
    "xi_mm",
    [
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 2.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, -1.5, 1.5),
        (0.0, 0.0, 2.5, 0.0, 0.0, 0.0),
        (1.0, -1.0, 0.5, 1.0, 1.0, -1.0),
    ],
)
def test_halves_made_with_two_poses_disagree_by_their_distance(xi_mm: tuple[float, ...]) -> None:
    odd, other = np.arange(len(SLICES)) % 2 == 1, displaced(np.array(xi_mm))
    apart = mean_displacement_mm(toy_pose(), other, CENTER_MM)
    # what is left without displacement is the 3 mm pixel
    assert disagreements(moved(odd, other)).split_half_mm == pytest.approx(apart, rel=0.15, abs=0.25)


@pytest.mark.parametrize("group", [0, 1, 2])
def test_a_displaced_part_of_the_cycle_is_found(group: int) -> None:
    part = phase_groups(PHASES)[group]
    other = displaced(np.array([0.0, 0.0, 0.0, 2.0, -1.0, 1.0]))
    found = disagreements(replace(moved(part, other), model_phase=PHASES))
    apart = mean_displacement_mm(toy_pose(), other, CENTER_MM)
    assert found.phase_mm == pytest.approx(apart, rel=0.3)
    assert found.phase_mm is not None
    assert found.phase_mm > found.split_half_mm, "the halves hold as much of it each"


def test_parts_of_one_heart_agree() -> None:
    still = disagreements(PHASED)
    assert still.phase_mm is not None
    assert still.half_volume_mm is not None
    assert max(still.split_half_mm, still.phase_mm, still.half_volume_mm) < 0.8


def test_a_part_that_says_nothing_stays_with_the_whole() -> None:
    """One slice leaves two directions open: its optimum does not run away along them."""
    blank = SLICES.images.copy()
    blank[2::2] = 0.5 + 1e-3 * np.random.default_rng(4).random(blank[2::2].shape)
    found = disagreements(replace(SLICES, images=np.where(SLICES.masks, blank, 0).astype(np.float32)))
    assert found.split_half_mm < 6.0


def test_parts_of_the_cycle_are_contiguous_equal_and_complete() -> None:
    groups = phase_groups(PHASES)
    np.testing.assert_array_equal(np.sum(groups, axis=0), 1)
    assert [int(g.sum()) for g in groups] == [8, 8, 8]
    assert all(PHASES[a].max() < PHASES[b].min() for a, b in pairwise(groups))


def test_slices_of_one_phase_stay_together_and_few_phases_are_no_parts() -> None:
    phases = np.repeat([0.75, 0.0, 0.35], [5, 9, 7])
    groups = phase_groups(phases)
    np.testing.assert_array_equal(np.sum(groups, axis=0), 1)
    assert sorted(tuple(np.unique(phases[g])) for g in groups) == [(0.0,), (0.35,), (0.75,)]
    assert phase_groups(np.repeat([0.0, 0.4], 6)) == ()
    assert disagreements(SLICES).phase_mm is None


def test_the_z_score_is_of_the_match_and_not_of_the_image() -> None:
    rng = np.random.default_rng(3)
    noise = replace(SLICES, images=rng.random(SLICES.images.shape).astype(np.float32))
    chart, away = PoseChart(toy_pose(), CENTER_MM), PoseChart(displaced(15 * np.eye(6)[4]), CENTER_MM)
    at, off, none = (
        wrong_pose_z_score(Lc2(s, MODEL, patch_mm=13.0, pitch_mm=3.0), c, np.random.default_rng(8))
        for s, c in ((SLICES, chart), (SLICES, away), (noise, chart))
    )
    enough = RegistrationOptions().limits.z_score
    assert at > enough > off
    assert abs(none) < 3.0, "one draw among wrong ones: three standard deviations"


def test_the_worst_test_decides() -> None:
    good = Evidence(z_score=11.0, split_half_mm=0.2, phase_mm=0.5, half_volume_mm=0.9, boundary_mm=0.8)
    assert good.worst_test_ratio(VOLUME_LIMITS) == pytest.approx(0.5)
    for name, bad in (
        ("z_score", 2.75),
        ("split_half_mm", 4.0),
        ("phase_mm", 4.4),
        ("half_volume_mm", 5.0),
        ("boundary_mm", 6.0),
    ):
        assert replace(good, **{name: bad}).worst_test_ratio(VOLUME_LIMITS) == pytest.approx(2.0)
    untested = replace(good, phase_mm=None, half_volume_mm=None, boundary_mm=None)
    assert untested.worst_test_ratio(VOLUME_LIMITS) == pytest.approx(0.5)
    assert replace(good, half_volume_mm=float("nan")).worst_test_ratio(VOLUME_LIMITS) == np.inf
    assert replace(good, phase_mm=6.0).worst_test_ratio(SLICE_LIMITS) == pytest.approx(2.0)
    assert replace(good, phase_mm=100.0).worst_test_ratio(IMAGE_LIMITS) < 1.0


def test_half_volumes_hold_each_pixel_once() -> None:
    for axis in range(3):
        sides = [half_space(SLICES, toy_pose(), CENTER_MM, axis, sign) for sign in (1.0, -1.0)]
        assert sum(int(side.masks.sum()) for side in sides) == int(SLICES.masks.sum())
        assert all((side.images[~side.masks] == 0).all() for side in sides)


def test_half_volumes_of_a_deformed_heart_disagree() -> None:
    """Slices on one side of the centre were seen with the heart 4 mm along: no one pose fits."""
    whole = disagreements(SLICES).half_volume_mm
    side = half_space(SLICES, toy_pose(), CENTER_MM, 0, 1.0)
    rest = half_space(SLICES, toy_pose(), CENTER_MM, 0, -1.0)
    step = displaced(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 4.0])).inverse() @ toy_pose()
    maps = step.rotation @ side.frame_from_pixel
    maps[:, :, 2] += step.translation_mm
    bent = disagreements(joined([rest, replace(side, frame_from_pixel=maps)])).half_volume_mm
    assert whole is not None
    assert bent is not None
    assert whole < 0.7
    assert bent > whole + 0.8
