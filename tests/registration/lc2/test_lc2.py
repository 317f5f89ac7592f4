"""LC2: the kernel against its NumPy reference, and what the score must not depend on."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numba import config
from scipy import ndimage
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import FloatArray, Grid, InvalidInputError, Rigid, VolumeSeries
from dvf_ig.kernels.lc2.slices import RIDGE, sample_channels
from dvf_ig.kernels.lc2.step import sample_gradients
from dvf_ig.registration import Lc2, ModelChannels, SliceSet, SliceThreads, channels_from_mr
from dvf_ig.registration.lc2.patches import pixel_runs
from dvf_ig.registration.pose_chart import PoseChart


def lc2_reference(slices: SliceSet, model: ModelChannels, pose: Rigid, radius: int) -> tuple[float, float]:
    """What LC2 says, spelt out: loop over patches and solve each ridge regression."""
    score = weight = 0.0
    rows, cols = slices.images.shape[1:]
    for image, mask, to_mm in zip(slices.images, slices.masks, slices.frame_from_pixel, strict=True):
        row, col = np.mgrid[:rows, :cols]
        mm = pose.apply_array(np.stack([col, row, np.ones_like(row)], -1) @ to_mm.T)
        index = np.moveaxis(model.grid.to_index(mm), -1, 0)
        first, second = (
            ndimage.map_coordinates(model.values[0, ..., c].astype(float), index, order=1, mode="nearest")
            for c in range(2)
        )
        for r in range(0, rows, 2):
            for c in range(0, cols, 2):
                window = np.zeros_like(mask)
                window[max(0, r - radius) : r + radius + 1, max(0, c - radius) : c + radius + 1] = True
                window &= mask
                if not mask[r, c] or window.sum() < 0.6 * (2 * radius + 1) ** 2:
                    continue
                u = image[window].astype(float)
                design = np.column_stack([first[window], second[window]])
                design -= design.mean(axis=0)
                normal = design.T @ design / window.sum() + RIDGE * np.eye(2)
                right = design.T @ (u - u.mean()) / window.sum()
                score += u.std() * (right @ np.linalg.solve(normal, right)) / u.var()
                weight += u.std()
    return score, weight


def test_kernel_equals_readable_twin() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=5.0, speckle=0.3)
    masks = np.random.default_rng(3).random(slices.images.shape) > 0.15
    holed = SliceSet(
        slices.frame,
        np.where(masks, slices.images, 0).astype(np.float32),
        masks,
        slices.frame_from_pixel,
        slices.model_phase,
        slices.t_s,
    ).subset(np.array([0, 5, 9]))
    model = channels_from_mr(toy_mr(), smoothing_mm=2.0)
    out = Lc2(holed, model, patch_mm=20.0, pitch_mm=5.0).per_slice(toy_pose())
    score, weight = lc2_reference(holed, model, toy_pose(), radius=2)
    assert out[:, 1].sum() == pytest.approx(weight, rel=1e-5)
    assert out[:, 0].sum() == pytest.approx(score, rel=1e-5)


def matrix_reference(slices: SliceSet, model: ModelChannels, pose: Rigid, radius: int) -> FloatArray:
    """JᵀJ spelt out: patches fitted one by one, channels differenced over the pose at every pixel."""
    out, (rows, cols) = np.zeros((6, 6)), slices.images.shape[1:]
    row, col = np.mgrid[:rows, :cols]
    for image, mask, to_mm in zip(slices.images, slices.masks, slices.frame_from_pixel, strict=True):
        place = np.stack([col, row, np.ones_like(row)], -1) @ to_mm.T

        def channels(at: Rigid, place: FloatArray = place) -> FloatArray:
            index = np.moveaxis(model.grid.to_index(at.apply_array(place)), -1, 0)
            both = [model.values[0, ..., c].astype(float) for c in range(2)]
            return np.stack([ndimage.map_coordinates(v, index, order=1, mode="nearest") for v in both])

        chart = PoseChart(pose, CENTER_MM)
        steps = 1e-4 * np.eye(6)
        slope = np.stack(
            [(channels(chart.pose(x)) - channels(chart.pose(-x))) / 2e-4 for x in steps], axis=-1
        )
        value = channels(pose)
        for r, c in itertools.product(range(0, rows, 2), range(0, cols, 2)):
            window = np.zeros_like(mask)
            window[max(0, r - radius) : r + radius + 1, max(0, c - radius) : c + radius + 1] = True
            window &= mask
            if not mask[r, c] or window.sum() < 0.6 * (2 * radius + 1) ** 2:
                continue
            u, design = image[window].astype(float), value[:, window].T
            design = design - design.mean(axis=0)
            normal = design.T @ design / window.sum() + RIDGE * np.eye(2)
            fit = np.linalg.solve(normal, design.T @ (u - u.mean()) / window.sum())
            jacobian = np.einsum("c,cni->ni", fit, slope[:, window])
            out += jacobian.T @ jacobian / (window.sum() * u.std())
    return out


def test_matrix_equals_readable_twin() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=5.0, speckle=0.3)
    few = slices.subset(np.array([0, 7]))
    model = channels_from_mr(toy_mr(), smoothing_mm=2.0)
    metric = Lc2(few, model, patch_mm=20.0, pitch_mm=5.0)
    expected = matrix_reference(few, model, toy_pose(), radius=2)
    found = metric.normal_equations(toy_pose(), CENTER_MM).matrix
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_sampling_is_trilinear_inside_and_counts_the_overlap() -> None:
    grid = np.stack(np.meshgrid(*(np.arange(8.0),) * 3, indexing="ij"), -1)
    linear = 2 * grid[..., 0] - grid[..., 1] + 0.5 * grid[..., 2]
    channels = np.stack([linear, -linear], -1)[None].astype(np.float32).reshape(1, 8, 8, 16)
    matrix = np.array([[0.5, 0.0, 0.25], [0.0, 0.5, 1.0], [0.0, 0.0, 3.5]])
    rows = np.arange(20)
    # every row twice, from column 0 to 4 and from 6 to 10
    runs = np.column_stack(
        [np.repeat(rows, 2), np.tile([0, 6], 20), np.tile([4, 10], 20), 4 * np.arange(40) + 100]
    )
    samples, gradients = np.empty((2, 160, 8))
    inside = sample_channels(channels, 0, matrix, runs, samples)
    sample_gradients(channels, 0, matrix, runs, gradients)
    row, col = (a.ravel() for a in np.meshgrid(rows, [0, 1, 2, 3, 6, 7, 8, 9], indexing="ij"))
    within = 0.5 * row + 1 <= 7
    expected = 2 * (0.5 * col + 0.25) - (0.5 * row + 1) + 0.5 * 3.5
    np.testing.assert_allclose(samples[within, 0], expected[within], atol=1e-12)
    np.testing.assert_allclose(samples[:, 1], -samples[:, 0])
    assert inside == within.sum()
    np.testing.assert_allclose(gradients[:, :2], samples[:, :2], atol=1e-12)
    slope = np.stack([np.full(160, 2.0), np.where(within, -1.0, 0.0), np.full(160, 0.5)], axis=1)
    np.testing.assert_allclose(gradients[:, 2::2], slope, atol=1e-12)
    np.testing.assert_allclose(gradients[:, 3::2], -slope, atol=1e-12)


def test_pixels_are_kept_in_runs_along_the_rows() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=5.0, speckle=0.3)
    masks = np.random.default_rng(3).random(slices.images.shape) > 0.3
    masks[1] = False
    kept = pixel_runs(replace(slices, masks=masks))
    again = np.zeros_like(masks)
    for s, (begin, end) in enumerate(itertools.pairwise(kept.first)):
        for row, first, last, pixel in kept.runs[begin:end]:
            again[s, row, first:last] = True
            np.testing.assert_array_equal(
                kept.values[pixel : pixel + last - first], slices.images[s, row, first:last]
            )
    np.testing.assert_array_equal(again, masks)
    assert len(kept.values) == masks.sum()


def test_slices_without_a_pixel_count_for_nothing() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)
    masks = slices.masks.copy()
    masks[2] = False
    metric = _metric(replace(slices, masks=masks))
    np.testing.assert_array_equal(metric.per_slice(toy_pose())[2], 0.0)
    found = metric.cost_gradient(toy_pose(), CENTER_MM)
    assert found.cost[2] == 0.0
    np.testing.assert_array_equal(found.gradient[2], 0.0)


def test_a_model_of_one_voxel_along_an_axis_is_refused() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)
    thick = channels_from_mr(toy_mr(), smoothing_mm=2.0)
    shape = (*thick.grid.shape[:2], 1)
    grid = Grid.axis_aligned("mr", shape, thick.grid.origin_mm, thick.grid.spacing_mm)
    thin = ModelChannels(grid, thick.values[:, :, :, :1].copy(), thick.fractions)
    with pytest.raises(InvalidInputError, match="two or more"):
        Lc2(slices, thin, patch_mm=13.0, pitch_mm=3.0)


def _metric(slices: SliceSet, threads: SliceThreads | None = None) -> Lc2:
    model = channels_from_mr(toy_mr(), smoothing_mm=1.0)
    return Lc2(slices, model, patch_mm=13.0, pitch_mm=3.0, threads=threads)


def test_score_ignores_brightness_and_contrast_of_the_ultrasound() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)
    brighter = SliceSet(
        slices.frame,
        (5.0 - 2.0 * slices.images).astype(np.float32),
        slices.masks,
        slices.frame_from_pixel,
        slices.model_phase,
        slices.t_s,
    )
    first, second = _metric(slices).score(toy_pose()), _metric(brighter).score(toy_pose())
    assert abs(first.similarity - second.similarity) < 1e-5


def test_true_pose_scores_above_displaced_ones() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)
    metric, rng = _metric(slices), np.random.default_rng(1)
    best = metric.score(toy_pose()).similarity
    for _ in range(12):
        shift = rng.normal(size=3)
        moved = toy_pose().perturbed_left(
            0.05 * rng.normal(size=3), 6 * shift / np.linalg.norm(shift), [0, 0, 0]
        )
        assert metric.score(moved).similarity < best


def test_normal_equations_carry_the_score_and_its_gradient() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.1)
    metric = Lc2(slices, channels_from_mr(toy_mr(), smoothing_mm=3.0), patch_mm=13.0, pitch_mm=3.0)
    away = PoseChart(toy_pose(), CENTER_MM).pose(np.array([2.0, -1.0, 1.5, 1.0, -2.0, 1.5]))
    here = metric.normal_equations(away, CENTER_MM)
    assert here.slope.similarity == pytest.approx(metric.score(away).similarity, rel=1e-9)
    np.testing.assert_array_equal(here.slope.right, metric.slope(away, CENTER_MM).right)
    chart, slope = PoseChart(away, CENTER_MM), np.empty(6)
    for i, step in enumerate(0.05 * np.eye(6)):
        ahead, behind = (metric.score(chart.pose(s)).similarity for s in (step, -step))
        slope[i] = here.slope.weight * (ahead - behind) / 0.1
    # half the gradient of the weighted score; trilinear channels bend at every voxel
    np.testing.assert_allclose(2 * here.slope.right, slope, atol=0.04 * np.abs(slope).max())
    assert np.linalg.eigvalsh(here.matrix).min() > 0


@pytest.mark.parametrize("threads", [2, 5])
def test_score_is_the_same_at_any_thread_count(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)
    alone = _metric(slices).per_slice(toy_pose())
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", threads)
    with SliceThreads() as shared:
        metric = _metric(slices, shared)
        np.testing.assert_array_equal(metric.per_slice(toy_pose()), alone)
    np.testing.assert_array_equal(metric.per_slice(toy_pose()), alone, "a metric outlives its threads")


def test_overlap_falls_to_nothing_far_away() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)
    away = Rigid("mr", "tracker", toy_pose().rotation, toy_pose().translation_mm + 500.0)
    assert _metric(slices).score(away).overlap == 0.0


def test_each_slice_is_compared_with_the_volume_of_its_own_phase() -> None:
    """A heart that lies 8 mm lower in its second phase: swapped phases must fit clearly worse."""
    still = toy_mr()
    moved = np.roll(still.values[0], 4, axis=2)
    beating = VolumeSeries(still.grid, np.stack([still.values[0], moved]), still.timing)
    lower = VolumeSeries(still.grid, np.stack([moved, moved]), still.timing)
    early, late = (
        toy_slices(mr, toy_pose(), np.random.default_rng(7), pitch_mm=4.0, speckle=0.0)
        for mr in (beating, lower)
    )
    first, second = still.timing.fractions
    images = np.concatenate([early.images[:6], late.images[6:]])
    phases = np.repeat([first, second], 6)
    model = channels_from_mr(beating, smoothing_mm=2.0)
    own, swapped = (
        Lc2(replace(early, images=images, model_phase=p), model, patch_mm=20.0, pitch_mm=4.0)
        .score(toy_pose())
        .similarity
        for p in (phases, phases[::-1])
    )
    assert own > 0.95, "nothing but interpolation is in the way"
    assert swapped < own - 0.2
