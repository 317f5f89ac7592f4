"""LC2: the kernel against its readable twin, and what the score must not depend on."""

import numpy as np
from numba import set_num_threads
from toy_heart import toy_mr, toy_pose, toy_slices

from dvf_ig.core import Rigid
from dvf_ig.kernels.similarity import integrate, lc2_reference, lc2_slices, sample_channels
from dvf_ig.registration import Lc2, SliceSet, channels_from_mr


def test_kernel_equals_readable_twin() -> None:
    rng = np.random.default_rng(3)
    rows, cols, radius, least = 17, 23, 3, 25.0
    mask = rng.random((rows, cols)) > 0.15
    image = (rng.random((rows, cols)) * mask).astype(np.float32)
    channels = rng.normal(size=(1, 12, 12, 12, 2)).astype(np.float32)
    matrix = np.array([[0.3, 0.05, 1.0], [0.02, 0.4, 2.0], [0.1, 0.1, 3.0]])
    size = (1, rows + 2 * radius + 1, cols + 2 * radius + 1)
    sums = [np.empty(size) for _ in range(3)]
    u = image.astype(np.float64)
    for table, source in zip(sums, (mask.astype(np.float64), u, u * u), strict=True):
        integrate(source, radius, table[0])
    values, tables, out = np.empty((1, 2, rows, cols)), np.empty((1, 7, *size[1:])), np.empty((1, 3))
    phases = np.zeros(1, dtype=np.int64)
    lc2_slices(
        image[None], mask[None], *sums, matrix[None], phases, channels, radius, least, values, tables, out
    )
    sampled = np.empty((2, rows, cols))
    sample_channels(channels, 0, matrix, mask, sampled)
    score, weight = lc2_reference(image.astype(np.float64), mask, *sampled, radius, least)
    np.testing.assert_allclose(out[0, :2], [score, weight], rtol=1e-9)


def test_sampling_is_trilinear_inside_and_counts_the_overlap() -> None:
    grid = np.stack(np.meshgrid(*(np.arange(8.0),) * 3, indexing="ij"), -1)
    linear = 2 * grid[..., 0] - grid[..., 1] + 0.5 * grid[..., 2]
    channels = np.stack([linear, -linear], -1)[None].astype(np.float32)
    matrix = np.array([[0.5, 0.0, 0.25], [0.0, 0.5, 1.0], [0.0, 0.0, 3.5]])
    mask = np.ones((20, 10), dtype=bool)
    out = np.empty((2, 20, 10))
    inside = sample_channels(channels, 0, matrix, mask, out)
    row, col = np.mgrid[:20, :10]
    within = 0.5 * row + 1 <= 7
    expected = 2 * (0.5 * col + 0.25) - (0.5 * row + 1) + 0.5 * 3.5
    np.testing.assert_allclose(out[0][within], expected[within], atol=1e-4)
    np.testing.assert_allclose(out[1], -out[0])
    assert inside == within.mean()


def _metric(slices: SliceSet) -> Lc2:
    return Lc2(slices, channels_from_mr(toy_mr(), smoothing_mm=1.0), patch_mm=13.0, pitch_mm=3.0)


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


def test_score_is_the_same_at_any_thread_count() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)
    metric = _metric(slices)
    both = metric.per_slice(toy_pose())
    set_num_threads(1)
    try:
        np.testing.assert_array_equal(metric.per_slice(toy_pose()), both)
    finally:
        set_num_threads(2)


def test_overlap_falls_to_nothing_far_away() -> None:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)
    away = Rigid("mr", "tracker", toy_pose().rotation, toy_pose().translation_mm + 500.0)
    assert _metric(slices).score(away).overlap == 0.0
