"""Pairs of 3-D images that are no hearts: what is looked at, known-pose recovery, and what is refused."""

from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.organ_pair.pair import OrganPair, displaced_start, organ_pair
from dvf_ig.core import Grid, InvalidInputError, NoOverlapError, Rigid, Stop, Volume
from dvf_ig.registration import PairEvidence, RegistrationResult, register_pair
from dvf_ig.registration.lc2.volume_lc2 import VolumeChannels
from dvf_ig.registration.pairs.check import jackknife_covariance, jackknife_mm, mirrored
from dvf_ig.registration.pairs.images import (
    EROSION_MM,
    channels_around,
    extent_mm,
    fan_volume,
    share_inside,
    usable_voxels,
)
from dvf_ig.registration.pairs.pair import stop_of
from dvf_ig.registration.pairs.search import REACH_MM, place_of

HERE = Rigid.identity("moving", "fixed")
MIDDLE = np.array([30.0, -20.0, 12.0])
SLOPE = np.array([2.0, -1.0, 3.0])


def oblique(frame: str, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> Grid:
    """A turned grid about MIDDLE."""
    direction = Rotation.from_euler("zyx", [25, -15, 40], degrees=True).as_matrix()
    origin = MIDDLE - direction @ (np.array(spacing) * (np.array(shape) - 1) / 2)
    return Grid(frame, shape, origin, np.array(spacing), direction)


def ramp(grid: Grid) -> np.ndarray:
    """A linear function of the place in mm: averages of it are its value at the average place."""
    return 500.0 + (grid.centers_mm() - MIDDLE) @ SLOPE


def ball(radius_mm: float = 18.0) -> Volume:
    """A ramp in a ball with a dark core, 0 outside."""
    grid = oblique("fixed", (60, 50, 32), (0.8, 1.0, 1.5))
    away = np.linalg.norm(grid.centers_mm() - MIDDLE, axis=-1)
    return Volume(grid, np.where((away < radius_mm) & (away > 5.0), ramp(grid), 0.0))


def test_the_fan_is_what_is_not_zero_with_its_dark_core_and_eroded() -> None:
    image = ball()
    usable = usable_voxels(image, None)
    assert extent_mm(image, usable) == pytest.approx(36.0, abs=2.0)
    fan = fan_volume(image, usable, 1.6)
    np.testing.assert_allclose(fan.grid.spacing_mm, [1.6, 2.0, 1.5])  # whole voxels
    places = fan.grid.centers_mm()
    away = np.linalg.norm(places - MIDDLE, axis=-1)
    # half a block's diagonal
    assert fan.insonified[away < 18.0 - EROSION_MM - 1.5].all()
    assert not fan.insonified[away > 18.0 - EROSION_MM + 1.5].any()
    assert (fan.values[away < 3.0] == 0.0).all()
    between = fan.insonified & (away > 8.0) & (away < 13.0)
    ratio = fan.values[between] / (500.0 + (places[between] - MIDDLE) @ SLOPE)
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=1e-3)


def test_a_lost_frame_is_no_dark_tissue() -> None:
    grid = oblique("fixed", (40, 40, 40), (1.0, 1.0, 1.0))
    values = ramp(grid)
    values[:, 20] = 0.0
    image = Volume(grid, values)
    fan = fan_volume(image, usable_voxels(image, None), 1.0)
    assert not fan.insonified[2:-2, 20, 2:-2].any()
    assert fan.insonified[2:-2, [17, 23], 2:-2].all()


def test_a_fan_cut_off_by_the_box_keeps_what_touches_it() -> None:
    grid = oblique("fixed", (20, 22, 24), (1.0, 1.0, 1.0))
    full = Volume(grid, ramp(grid))
    assert fan_volume(full, usable_voxels(full, None), 1.0).insonified.all()


def test_several_images_become_channels_in_their_place() -> None:
    image = ball()
    fan = fan_volume(image, usable_voxels(image, None), 1.6)
    first = oblique("moving", (120, 130, 90), (0.6, 0.6, 1.2))
    second = Grid.axis_aligned("moving", (70, 70, 70), MIDDLE - 49.0, 1.4)
    model = channels_around([Volume(first, ramp(first)), Volume(second, 2 * ramp(second))], fan, HERE, 4.0)
    places = model.grid.centers_mm()
    near = np.linalg.norm(places - MIDDLE, axis=-1) < 20.0
    expected = (places[near] - MIDDLE) @ SLOPE
    for channel in (0, 2):
        slope, offset = np.polyfit(expected, model.values[near][:, channel], 1)
        np.testing.assert_allclose(model.values[near][:, channel], slope * expected + offset, atol=1e-3)
    assert share_inside([Volume(first, ramp(first))], fan, HERE) == 1.0


def test_a_fine_image_is_averaged_to_the_same_channels() -> None:
    """Blocks of voxels are averaged before smoothing: no shift, and hardly another blur."""
    image = ball()
    fan = fan_volume(image, usable_voxels(image, None), 4.0)
    made = []
    for count, spacing in ((36, 1.6), (144, 0.4)):
        grid = oblique("moving", (count,) * 3, (spacing,) * 3)
        away = np.linalg.norm(grid.centers_mm() - MIDDLE - 3.0, axis=-1)
        made.append(channels_around([Volume(grid, np.exp(-np.square(away / 9.0)))], fan, HERE, 4.0).values)
    np.testing.assert_allclose(made[0], made[1], atol=0.2)


def test_a_mirrored_model_is_the_model_at_mirrored_places() -> None:
    grid = oblique("moving", (24, 20, 16), (1.0, 1.5, 2.0))
    values = np.stack([ramp(grid), ramp(grid) ** 2], axis=-1).astype(np.float32)
    center = MIDDLE + np.array([1.3, -2.1, 0.7])
    for axis in range(3):
        there = mirrored(VolumeChannels(grid, values), axis, center)
        normal = grid.direction[:, axis]
        places = there.grid.centers_mm()
        reflected = places - 2 * ((places - center) @ normal)[..., None] * normal
        np.testing.assert_allclose(there.values[..., 0], 500 + (reflected - MIDDLE) @ SLOPE, rtol=1e-5)


@lru_cache
def brain() -> OrganPair:
    """With labels on a coarser grid than studies have: quick."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("data_synth.organ_pair.brain.VOXEL_MM", 2.0)
        return organ_pair(1002)


def test_a_simulated_pair_is_like_a_real_one() -> None:
    """A fan in a third of the box, three contrasts on grids of their own, and a shift of the tissue."""
    pair = brain()
    assert 0.2 < (pair.fixed.values > 0).mean() < 0.5
    assert 0.1 < pair.error_mm(pair.moving_from_fixed) < 2.0
    start = displaced_start(pair, 8.0, np.random.default_rng(0))
    at = pair.moving_from_fixed.apply_array(pair.fixed_mm)
    assert np.linalg.norm(start.apply_array(pair.fixed_mm) - at, axis=1).mean() == pytest.approx(
        8.0, rel=0.01
    )
    assert sorted(pair.moving) == ["flair", "t1", "t2"]
    assert not np.allclose(pair.moving["t1"].grid.direction, pair.moving["flair"].grid.direction)


def registered(start: Rigid, *contrasts: str) -> RegistrationResult:
    moving = [brain().moving[name] for name in contrasts]
    return register_pair(brain().fixed, moving, start, rng=np.random.default_rng(0), clock=perf_counter)


def test_recovers_a_brain_and_says_how_well() -> None:
    pair = brain()
    floor_mm = pair.error_mm(pair.moving_from_fixed)
    result = registered(displaced_start(pair, 8.0, np.random.default_rng(1)), "t1", "flair")
    error_mm = pair.error_mm(result.target_from_source)
    assert result.stop is Stop.CONVERGED
    assert error_mm < floor_mm + 0.25  # a sixth of the fine pitch
    assert result.success_probability is not None
    assert result.success_probability > 0.9
    assert result.evidence.pair is not None
    assert 0.0 < result.evidence.pair.parts_mm < 1.0
    assert np.linalg.eigvalsh(result.covariance).min() > 0


def test_another_place_of_the_brain_is_not_called_a_success() -> None:
    """The start is turned round: MR of another anatomy lies where the ultrasound looks."""
    pair = brain()
    center = pair.moving_mm.mean(axis=0)
    start = pair.moving_from_fixed.perturbed_left([0.0, 0.0, np.pi], np.zeros(3), center)
    result = registered(start, "flair")
    assert pair.error_mm(result.target_from_source) > 10.0
    assert not result.stop.usable
    assert result.success_probability is not None
    assert result.success_probability < 0.2
    assert "check that both images are of this patient" in result.sentence


def test_misuse_says_what_to_do() -> None:
    image, grid = ball(), oblique("moving", (40, 40, 40), (1.0, 1.0, 1.0))
    moving, rng = Volume(grid, ramp(grid)), np.random.default_rng(0)
    away = Rigid("moving", "fixed", np.eye(3), np.array([300.0, 0, 0]))
    with pytest.raises(NoOverlapError, match=r"0 % of the ultrasound .* give a start with --init"):
        register_pair(image, [moving], away, rng=rng, clock=perf_counter)
    dark = Volume(image.grid, np.zeros(image.grid.shape))
    with pytest.raises(InvalidInputError, match="no non-zero voxel"):
        register_pair(dark, [moving], HERE, rng=rng, clock=perf_counter)
    flat = Volume(image.grid, np.ones(image.grid.shape))
    with pytest.raises(InvalidInputError, match="one value throughout"):
        register_pair(flat, [moving], HERE, rng=rng, clock=perf_counter)
    holed = np.where(np.arange(40) == 20, np.nan, ramp(grid))
    with pytest.raises(InvalidInputError, match="voxels of the moving image are no numbers"):
        register_pair(image, [Volume(grid, holed)], HERE, rng=rng, clock=perf_counter)
    elsewhere = Grid("fixed", image.grid.shape, image.grid.origin_mm + 5, image.grid.spacing_mm, np.eye(3))
    with pytest.raises(InvalidInputError, match="resample the mask onto the fixed image's grid"):
        register_pair(
            image,
            [moving],
            HERE,
            rng=rng,
            clock=perf_counter,
            mask=Volume(elsewhere, np.ones(image.grid.shape)),
        )


def evidence(**changed: Any) -> PairEvidence:
    usual: dict[str, Any] = {
        "agreeing_starts": 0.5,
        "similarity": 0.3,
        "chance": 0.1,
        "elsewhere": np.array([0.2, 0.15]),
        "jackknife_mm": 0.5,
        "halves_mm": 0.8,
        "z_score": 10.0,
        "moved_mm": 4.0,
        "mirrored_share": 0.9,
    }
    return PairEvidence(**(usual | changed))


def test_the_strongest_doubt_names_the_reason() -> None:
    assert evidence().stop is Stop.CONVERGED
    assert evidence().next_best_share == pytest.approx(0.5)
    apart = evidence(jackknife_mm=3.0, halves_mm=4.0)
    assert apart.stop is Stop.DISAGREEMENT
    assert "disagree by 3.5 mm" in apart.sentence
    alone = evidence(agreeing_starts=1 / 32, elsewhere=np.array([0.29]))
    assert alone.stop is Stop.AMBIGUOUS
    assert "3 % of the starts end at this pose" in alone.sentence
    assert evidence(elsewhere=np.zeros(0), agreeing_starts=1.0).success_probability > 0.98


def test_that_no_other_end_was_found_does_not_outweigh_parts_that_disagree() -> None:
    lonely = evidence(elsewhere=np.zeros(0), jackknife_mm=2.9, halves_mm=2.9, agreeing_starts=0.3)
    assert lonely.next_best_share == 0.0
    assert lonely.stop is Stop.DISAGREEMENT


def test_a_good_pose_that_lies_too_far_from_its_start_asks_for_a_nearer_one() -> None:
    assert stop_of(evidence(), 1.0, REACH_MM) is Stop.CONVERGED
    assert stop_of(evidence(), 1.0, REACH_MM + 0.1) is Stop.MOVED_TOO_FAR
    assert stop_of(evidence(), 0.2, REACH_MM + 0.1) is Stop.LOW_OVERLAP


def test_a_pose_far_from_its_start_is_less_likely() -> None:
    chances = [evidence(moved_mm=mm).success_probability for mm in (0.0, 4.0, 8.0, 16.0)]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] - chances[1] < 0.02  # a start of the usual error costs nothing


def test_what_no_limit_depends_on() -> None:
    """LC2 twice as large, everywhere, and another decoy change nothing."""
    scaled = evidence(similarity=0.6, chance=0.2, elsewhere=np.array([0.4, 0.3]), mirrored_share=0.2)
    assert scaled.doubt == pytest.approx(evidence().doubt)


def test_parts_that_agree_leave_a_covariance_that_is_never_open() -> None:
    place = place_of(np.random.default_rng(0).normal(0, 20, (100, 3)), HERE)
    same = [HERE] * 8
    assert jackknife_mm(same, place) == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.eigvalsh(jackknife_covariance(same, HERE, place)).min() > 0
    # each part left out moves the pose by 1 mm: 5/6 of the sum of six squares
    moved = [HERE.perturbed_left(np.zeros(3), shift, np.zeros(3)) for shift in [*np.eye(3), *-np.eye(3)]]
    assert jackknife_mm(moved, place) == pytest.approx(np.sqrt(5 / 6 * 6))
    assert jackknife_mm([], place) == np.inf
    assert np.isfinite(jackknife_covariance([], HERE, place)).all()


def test_height_above_wrong_poses_speaks_against_a_pose_and_never_for_it() -> None:
    assert evidence(z_score=40.0).doubt == evidence(z_score=10.0).doubt
    low = evidence(z_score=4.0)
    assert low.stop is Stop.AMBIGUOUS
    assert "4.0 standard deviations above wrong poses" in low.sentence
