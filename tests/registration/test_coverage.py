"""A heart that its images cover in part: what is compared, what is said of the sweep, and what wins."""

import sys
from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import Grid, Rigid, Stop, VolumeSeries
from dvf_ig.registration import (
    CoveredPart,
    HeartChannels,
    Level,
    RegistrationOptions,
    RegistrationResult,
    UltrasoundImages,
    channels_from_mr,
    covered_part,
    ends_within,
    register,
)
from dvf_ig.registration.coverage import RIM_MM
from dvf_ig.registration.evidence.assessment import (
    OF_STACK,
    OF_STACK_AND_VIEWS,
    Assessment,
    ImageStatistics,
    table_of,
)
from dvf_ig.registration.evidence.checks import PART_BOUNDARY_MM
from dvf_ig.registration.pose_chart import largest_error_bound_mm
from dvf_ig.registration.register import LARGEST_OF_PART_MM, _assessed

SHELL = CENTER_MM + np.array([48.0, 40.0, 44.0]) * (lambda v: v / np.linalg.norm(v, axis=1, keepdims=True))(
    np.random.default_rng(5).normal(size=(4000, 3))
)
"""Points on the toy heart's surface."""


def lower_half() -> tuple[VolumeSeries, VolumeSeries]:
    """Grey levels and labels of the toy heart up to 4 mm above its middle."""
    mr = toy_mr()
    top = 32
    grid = Grid.axis_aligned("mr", (70, 64, top), mr.grid.origin_mm, 2.0)
    inside = (((grid.centers_mm() - CENTER_MM) / [48.0, 40.0, 44.0]) ** 2).sum(axis=-1) < 1.0
    labels = np.stack([inside, inside]).astype(np.uint8)
    return VolumeSeries(grid, mr.values[..., :top], mr.timing), VolumeSeries(grid, labels, mr.timing)


def half_heart() -> HeartChannels:
    grey, labels = lower_half()
    channels = channels_from_mr(grey, smoothing_mm=1.0)
    return HeartChannels(channels, CENTER_MM, covered=covered_part(labels, SHELL))


def covered() -> CoveredPart:
    part = half_heart().covered
    assert part is not None
    return part


def levels() -> tuple[Level, Level]:
    made = [
        Level(toy_slices(toy_mr(), toy_pose(), np.random.default_rng(50), pitch_mm=p, speckle=0.3), p)
        for p in (3.0, 1.5)
    ]
    return made[0], made[1]


def registered(images: tuple[Level, Level], start: Rigid) -> RegistrationResult:
    return register(
        UltrasoundImages(*images, options=RegistrationOptions(starts=4)),
        half_heart(),
        start,
        rng=np.random.default_rng(0),
        clock=perf_counter,
    )


def test_images_end_within_a_heart_that_they_hold_in_part() -> None:
    grey, _ = lower_half()
    assert ends_within(grey.grid, SHELL)
    assert not ends_within(toy_mr().grid, SHELL)
    assert not ends_within(grey.grid, SHELL + 500.0)


def test_only_pixels_near_the_covered_heart_are_compared() -> None:
    slices, part = levels()[0].slices, covered()
    kept = part.compared(slices, toy_pose())
    rng = np.random.default_rng(2)
    for _ in range(400):
        s, row, column = (int(rng.integers(n)) for n in slices.masks.shape)
        place = toy_pose().apply_array(slices.frame_from_pixel[s] @ [column, row, 1.0])
        voxel = np.rint(part.grid.to_index(place)).astype(int)
        inside = ((voxel >= 0) & (voxel < part.grid.shape)).all()
        center = part.grid.to_mm(voxel.astype(float)) - CENTER_MM
        depth = np.linalg.norm(center / [48.0, 40.0, 44.0])
        if abs(depth - 1.0) * 44.0 < 2.0 * RIM_MM and inside:
            continue  # near the rim's edge the toy's depth is no distance
        assert kept.masks[s, row, column] == (bool(inside) and depth < 1.0)
    assert not kept.images[~kept.masks].any()


def test_points_beyond_the_images_or_far_from_the_heart_are_not_in_the_covered_part() -> None:
    points = CENTER_MM + np.array([[0.0, 0.0, -20.0], [0.0, 0.0, 20.0], [0.0, 43.0, -4.0], [0.0, 60.0, -4.0]])
    assert covered().holds(points).tolist() == [True, False, True, False]


def test_voxels_that_are_not_shown_at_every_phase_are_not_compared() -> None:
    _, labels = lower_half()
    shown = np.ones(labels.values.shape, dtype=np.bool_)
    shown[1, :, :, 20:] = False
    part = covered_part(labels, SHELL, shown)
    assert not part.compared_voxels[:, :, 20:].any()
    np.testing.assert_array_equal(part.compared_voxels[:, :, :20], covered().compared_voxels[:, :, :20])


def test_a_half_covered_heart_is_registered_by_its_half_and_refused_without_a_bound() -> None:
    start = toy_pose().perturbed_left([0.08, -0.06, 0.05], [5.0, -4.0, 6.0], CENTER_MM)
    result = registered(levels(), start)
    assert result.stop is Stop.UNBOUNDED, "every check passes, but nothing bounds what the other half does"
    assert result.options.limits.boundary_mm == PART_BOUNDARY_MM
    assert result.tre_bound_mm is None
    assert result.outside
    assert result.sentence.startswith("the MR ends within the heart, and no probability was calibrated")
    wide = replace(result, tre_bound_mm=7.3)
    assert "bound the error over its covered part to 7.3 mm only" in wide.sentence
    assert result.sentence.endswith(
        "or give the long-axis cines of the same examination (preop.views), or MR of the whole heart"
    )
    targets = CENTER_MM + np.random.default_rng(1).uniform(-40, 40, (27, 3))
    source = toy_pose().inverse().apply_array(targets)
    apart = np.linalg.norm(result.target_from_source.apply_array(source) - targets, axis=1)
    # a whole toy leaves 0.2 mm; its half is as sharp, but extrapolates to the other
    assert apart.mean() < 1.0
    assert result.coverage is not None
    assert result.overlap == result.coverage.share
    assert result.statistics is not None
    assert result.statistics.overlap > 0.8, "of what is compared, chosen half a voxel wider"


@pytest.mark.parametrize(("of_part_mm", "stop"), [(4.0, Stop.CONVERGED), (4.1, Stop.UNBOUNDED)])
def test_the_scaled_covariance_bounds_the_error_of_a_part_alone(
    of_part_mm: float, stop: Stop, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = "dvf_ig.registration.register"
    monkeypatch.setattr(sys.modules[module], "assess", lambda *_: Assessment(0.9, 3.0, covariance_scale=4.0))
    statistics = ImageStatistics(*([1.0] * 10))
    table = table_of("sweep", OF_STACK)
    ended, assessment = _assessed(Stop.CONVERGED, table, {}, {}, statistics, of_part_mm)
    assert (ended, LARGEST_OF_PART_MM) == (stop, 8.0)
    assert assessment.tre_bound_mm == 2.0 * of_part_mm
    ended, assessment = _assessed(Stop.CONVERGED, table, {}, {}, statistics, None)
    assert (ended, assessment.tre_bound_mm) == (Stop.CONVERGED, 3.0)


def test_tables_of_whole_hearts_say_nothing_of_a_part() -> None:
    assert table_of("volumes") is not None
    assert table_of("volumes", OF_STACK) is None
    assert table_of("sweep", OF_STACK) is not table_of("sweep")
    assert table_of("sweep", OF_STACK_AND_VIEWS) is not table_of("sweep")
    whole, part = table_of("sweep"), table_of("sweep", OF_STACK)
    assert whole is not None
    assert part is not None
    assert part.ranges["structure"][1] == whole.ranges["structure"][1], "what ultrasound looks like is shared"
    assert part.ranges["overlap"] != whole.ranges["overlap"]
    half = covered()
    assert (half.kind, replace(half, views=True).kind) == (OF_STACK, OF_STACK_AND_VIEWS)


def test_a_sweep_of_a_corner_is_refused_with_the_side_to_image() -> None:
    coarse, fine = levels()
    part = covered()

    def left_end(level: Level) -> Level:
        slices = level.slices
        masks = slices.masks.copy()
        rows, columns = slices.images.shape[1:]
        column, row = np.meshgrid(np.arange(columns), np.arange(rows))
        pixel = np.stack([column, row, np.ones_like(row)], axis=-1)
        for mask, frame_from_pixel in zip(masks, slices.frame_from_pixel, strict=True):
            place = toy_pose().apply_array((pixel @ frame_from_pixel.T).reshape(-1, 3))
            mask &= (place[:, 0] > CENTER_MM[0] + 30.0).reshape(rows, columns)
        images = np.where(masks, slices.images, np.float32(0))
        return replace(level, slices=replace(slices, images=images, masks=masks))

    shown = part.imaged_by(left_end(coarse).slices, toy_pose())
    assert shown.share < 0.35
    assert "towards the patient's right" in shown.advice
    assert part.imaged_by(coarse.slices, toy_pose()).share > 0.6
    result = registered((left_end(coarse), left_end(fine)), toy_pose())
    assert result.stop is Stop.LOW_OVERLAP
    assert result.sentence.startswith("the sweep images")


def test_the_bound_of_a_covariance_holds_for_the_largest_error_in_nineteen_of_twenty_draws() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(0.0, 0.5, (6, 6)) * np.array([0.02, 0.02, 0.02, 1.0, 1.0, 1.0])[:, None]
    points = CENTER_MM + rng.uniform(-40.0, 40.0, (100, 3))
    bound_mm = largest_error_bound_mm(root @ root.T, points, CENTER_MM)
    turn, shift = np.split(rng.normal(size=(4000, 6)) @ root.T, 2, axis=1)
    moved = np.cross(turn[:, None], points - CENTER_MM) + shift[:, None]
    within = np.linalg.norm(moved, axis=2).max(axis=1) < bound_mm
    assert 0.94 < within.mean() < 0.97
