"""Evidence of a pose: parts of the slices that are displaced by a known amount, on the toy heart."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import BoolArray, FloatArray, Rigid
from dvf_ig.registration import (
    Lc2,
    PoseChart,
    RegistrationOptions,
    SliceSet,
    channels_from_mr,
    distance_between,
)
from dvf_ig.registration.evidence.checks import (
    TRACKED_LIMITS,
    VOLUME_LIMITS,
    Evidence,
    contrast_of,
    doubt_of,
    halves_mm,
    phase_groups,
    phases_mm,
    success_probability,
)
from dvf_ig.registration.evidence.half_volumes import half_space, part_disagreement_mm
from dvf_ig.registration.lc2.curvature import Curvature, curvature_about
from dvf_ig.registration.lc2.optimise import ClimbOptions, climb
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


def optimum(slices: SliceSet) -> Curvature:
    lc2 = Lc2(slices, MODEL, patch_mm=13.0, pitch_mm=3.0)
    found = climb(lc2, toy_pose(), CENTER_MM, None, ClimbOptions(30, 2.0, 0.01))
    assert found.converged
    return curvature_about(lc2, PoseChart(found.pose, CENTER_MM))


def evidence(curvature: Curvature, phases: FloatArray = PHASES) -> Evidence:
    return Evidence(6.0, halves_mm(curvature), phases_mm(curvature, phases), 1.0, 1.0)


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
    even = np.arange(len(SLICES)) % 2 == 0
    odd, other = ~even, displaced(np.array(xi_mm))
    found = optimum(moved(odd, other))
    apart = distance_between(toy_pose(), other, CENTER_MM)
    # one step of Newton's from between the two; what is left without displacement is the 3 mm pixel
    assert evidence(found).halves_mm == pytest.approx(apart, rel=0.25, abs=0.2)
    for half, truth in ((even, toy_pose()), (odd, other)):
        assert distance_between(found.wish(half), truth, CENTER_MM) < 0.35 * apart + 0.35


@pytest.mark.parametrize("group", [0, 1, 2])
def test_a_displaced_part_of_the_cycle_is_found(group: int) -> None:
    still = evidence(optimum(SLICES))
    part = phase_groups(PHASES)[group]
    other = displaced(np.array([0.0, 0.0, 0.0, 2.0, -1.0, 1.0]))
    found = evidence(optimum(moved(part, other)))
    apart = distance_between(toy_pose(), other, CENTER_MM)
    assert still.phases_mm < 0.25 * apart
    assert found.phases_mm == pytest.approx(apart, rel=0.3)
    assert found.phases_mm > found.halves_mm, "the halves hold as much of it each"


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
    assert evidence(optimum(SLICES), np.zeros(24)).phases_mm == 0.0


def test_contrast_is_of_the_match_and_not_of_the_image() -> None:
    rng = np.random.default_rng(3)
    noise = replace(SLICES, images=rng.random(SLICES.images.shape).astype(np.float32))
    chart, away = PoseChart(toy_pose(), CENTER_MM), PoseChart(displaced(15 * np.eye(6)[4]), CENTER_MM)
    at, off, none = (
        contrast_of(Lc2(s, MODEL, patch_mm=13.0, pitch_mm=3.0), c, np.random.default_rng(8))
        for s, c in ((SLICES, chart), (SLICES, away), (noise, chart))
    )
    enough = RegistrationOptions().limits.contrast
    assert at > enough > off
    assert abs(none) < 3.0, "one draw among wrong ones: three standard deviations"


def test_the_weakest_check_decides() -> None:
    good = Evidence(contrast=11.0, halves_mm=0.2, phases_mm=0.5, parts_mm=0.9, edges_mm=0.8)
    assert doubt_of(good, VOLUME_LIMITS) == pytest.approx(0.5)
    for name, bad in (
        ("contrast", 2.75),
        ("halves_mm", 4.0),
        ("phases_mm", 2.44),
        ("parts_mm", 4.5),
        ("edges_mm", 4.8),
    ):
        assert doubt_of(replace(good, **{name: bad}), VOLUME_LIMITS) == pytest.approx(2.0)
    assert doubt_of(replace(good, parts_mm=None, edges_mm=None), VOLUME_LIMITS) == pytest.approx(0.5)
    assert doubt_of(replace(good, parts_mm=float("nan")), VOLUME_LIMITS) == np.inf
    assert doubt_of(replace(good, phases_mm=100.0), TRACKED_LIMITS) < 1.0


def test_probability_falls_with_doubt_and_is_even_at_the_limit() -> None:
    chances = [success_probability(doubt) for doubt in (0.0, 0.5, 0.9, 1.0, 1.1, 2.0, np.inf)]
    assert all(0.0 <= chance <= 1.0 for chance in chances)
    assert chances == sorted(chances, reverse=True)
    assert chances[3] == 0.5
    assert chances[0] > 0.999
    assert chances[-1] < 1e-9


def test_halves_of_space_hold_each_pixel_once() -> None:
    for axis in range(3):
        sides = [half_space(SLICES, toy_pose(), CENTER_MM, axis, sign) for sign in (1.0, -1.0)]
        assert sum(int(side.masks.sum()) for side in sides) == int(SLICES.masks.sum())
        assert all((side.images[~side.masks] == 0).all() for side in sides)


def test_halves_of_space_tear_a_bent_heart_apart() -> None:
    """Slices on one side of the centre were seen with the heart 4 mm along: no one pose fits."""
    whole = part_disagreement_mm(SLICES, MODEL, toy_pose(), CENTER_MM, 13.0, 3.0)
    side = half_space(SLICES, toy_pose(), CENTER_MM, 0, 1.0)
    rest = half_space(SLICES, toy_pose(), CENTER_MM, 0, -1.0)
    step = displaced(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 4.0])).inverse() @ toy_pose()
    maps = step.rotation @ side.frame_from_pixel
    maps[:, :, 2] += step.translation_mm
    bent = joined([rest, replace(side, frame_from_pixel=maps)])
    torn = part_disagreement_mm(bent, MODEL, toy_pose(), CENTER_MM, 13.0, 3.0)
    assert whole < 0.7
    assert torn > whole + 0.8
