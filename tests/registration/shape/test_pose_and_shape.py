"""Blocks that are moved are seen where they then lie; turns of the fit end at one place."""

from functools import cache

import numpy as np
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices
from toy_volume import toy_surface

from dvf_ig.core import FloatArray, Rigid, mean_displacement_mm
from dvf_ig.registration import Boundary, Lc2, PoseChart, boundary_points, channels_from_mr
from dvf_ig.registration.shape.blocks import BLOCK_MM, BlockedBoundary, BlockedLc2, BlockedMatch
from dvf_ig.registration.shape.fit import pose_and_shape

SLICES = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(0), pitch_mm=3.0, speckle=0.3)


@cache
def metric() -> Lc2:
    return Lc2(SLICES, channels_from_mr(toy_mr(), smoothing_mm=3.0), patch_mm=13.0, pitch_mm=3.0)


@cache
def boundary_at_blood() -> Boundary:
    return Boundary(boundary_points(SLICES), toy_surface())


def displaced(seed: int, away_mm: float) -> Rigid:
    xi = np.random.default_rng(seed).normal(size=6)
    return PoseChart(toy_pose(), CENTER_MM).pose(away_mm * xi / np.linalg.norm(xi))


def nothing(_: PoseChart) -> tuple[FloatArray, FloatArray]:
    return np.zeros((6, 6)), np.zeros(6)


def test_blocks_of_lc2_that_are_all_moved_alike_see_what_a_moved_pose_sees() -> None:
    blocks, shift = BlockedLc2(metric(), block_mm=BLOCK_MM), np.array([0.8, -1.1, 0.4])
    moved = Rigid("mr", "tracker", toy_pose().rotation, toy_pose().translation_mm + shift)
    every = np.repeat(shift[None], len(blocks.slice), axis=0)
    (expected,) = blocks.gradients([moved], CENTER_MM + shift)
    found = blocks.shifted(toy_pose(), every, CENTER_MM).gradient
    np.testing.assert_allclose(found[:, 3:], expected.gradient[:, 3:], rtol=1e-6, atol=1e-9)


def test_blocks_of_the_boundary_that_are_all_moved_alike_pull_as_at_a_moved_pose() -> None:
    blocks, shift = (
        BlockedBoundary(boundary_at_blood(), 0.2, CENTER_MM, block_mm=BLOCK_MM),
        np.array([0.8, -1.1, 0.4]),
    )
    moved = Rigid("mr", "tracker", toy_pose().rotation, toy_pose().translation_mm + shift)
    still, every = np.zeros((len(blocks.cell), 3)), np.repeat(shift[None], len(blocks.cell), axis=0)
    expected, found = blocks.expansion(moved, still, 0.0), blocks.expansion(toy_pose(), every, 0.0)
    np.testing.assert_allclose(found[0][:, 3:], expected[0][:, 3:], atol=1e-6)
    assert len(blocks.cell) > 10


def test_descents_from_two_millimetres_around_meet() -> None:
    ends, first = [], []
    for seed in range(4):
        chart = PoseChart(displaced(seed, 2.0), CENTER_MM)
        boundary = BlockedBoundary(boundary_at_blood(), 0.0, CENTER_MM, block_mm=BLOCK_MM)
        match = BlockedMatch(BlockedLc2(metric(), block_mm=BLOCK_MM), metric().information, boundary, chart)
        found = pose_and_shape(match, chart, nothing)
        ends.append(found.pose)
        first.append(chart.pose(found.first.step_mm))
    spread, before = (
        max(mean_displacement_mm(poses[0], pose, CENTER_MM) for pose in poses[1:]) for poses in (ends, first)
    )
    assert spread < 0.5 * before
    assert max(mean_displacement_mm(pose, toy_pose(), CENTER_MM) for pose in ends) < 1.0


def test_images_pull_displaced_blocks_back_to_where_they_belong() -> None:
    chart = PoseChart(toy_pose(), CENTER_MM)
    match = BlockedMatch(BlockedLc2(metric(), block_mm=BLOCK_MM), metric().information, None, chart)
    shift = np.repeat(np.array([[1.5, -1.0, 0.5]]), len(match), axis=0)
    gradient, curvature = match.similarity_expansion(toy_pose(), shift)
    step = -np.linalg.solve(curvature.sum(axis=0), gradient.sum(axis=0))
    assert np.linalg.norm(shift[0] + step) < 0.4 * np.linalg.norm(shift[0])
    assert np.linalg.eigvalsh(curvature).min() > -1e-9


def test_blocks_that_count_less_pull_less_and_leave_the_noise_of_lc2_as_it_is() -> None:
    chart, blocks = PoseChart(toy_pose(), CENTER_MM), BlockedLc2(metric(), block_mm=BLOCK_MM)
    half, whole = (
        BlockedMatch(blocks, metric().information, None, chart, of_block=of_block) for of_block in (1.5, 3.0)
    )
    still = np.full((len(whole), 3), 0.5)
    for less, more in zip(
        half.similarity_expansion(toy_pose(), still),
        whole.similarity_expansion(toy_pose(), still),
        strict=True,
    ):
        np.testing.assert_allclose(2.0 * less, more, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(half.curvature, whole.curvature, rtol=1e-12)
