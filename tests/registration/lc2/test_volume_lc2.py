"""LC2 with cubic patches: what a patch scores by a plain least-squares fit, and the exact gradient."""

import numpy as np
import pytest
from scipy import ndimage

from dvf_ig.core import FloatArray, Grid, Rigid
from dvf_ig.registration.lc2.lc2 import SliceThreads
from dvf_ig.registration.lc2.volume_lc2 import Blocks, VolumeChannels, VolumeLc2, blocks_of
from dvf_ig.registration.pose_chart import PoseChart

POSE = Rigid.from_rotation_vector([0.05, 0.02, -0.03], [1.0, 2.0, 1.5], "moving", "fixed")
CENTER = np.array([20.0, 20.0, 20.0])
EDGE = 4


def ultrasound() -> Blocks:
    rng = np.random.default_rng(0)
    grid = Grid("fixed", (26, 24, 22), np.array([1.0, 2.0, 3.0]), np.array([1.0, 1.1, 1.2]), np.eye(3))
    values = 10 * ndimage.gaussian_filter(rng.normal(size=grid.shape), 2).astype(np.float32)
    values[:5, :7] = np.nan
    return blocks_of(values, grid, EDGE)


def model(channels: int) -> VolumeChannels:
    rng = np.random.default_rng(1)
    grid = Grid.axis_aligned("moving", (50, 50, 50), np.array([-10.0, -8.0, -9.0]), 1.1)
    values = ndimage.gaussian_filter(rng.normal(size=(*grid.shape, channels)), (2, 2, 2, 0))
    return VolumeChannels(grid, (values / values.std()).astype(np.float32))


def numeric(metric: VolumeLc2) -> FloatArray:
    chart, step = PoseChart(POSE, CENTER), 1e-3
    return np.array(
        [
            (metric.score(chart.pose(step * e)).similarity - metric.score(chart.pose(-step * e)).similarity)
            / (2 * step)
            for e in np.eye(6)
        ]
    )


@pytest.mark.parametrize("channels", [2, 4])
def test_a_patch_scores_what_a_least_squares_fit_explains(channels: int) -> None:
    blocks, anatomy = ultrasound(), model(channels)
    with SliceThreads() as threads:
        scores = VolumeLc2(blocks, anatomy, threads).patch_scores(POSE)
    voxels = blocks.voxels
    for p in (0, len(scores) // 2, len(scores) - 1):
        members = [b for b in voxels.block_of_patch[p] if b >= 0]
        rows = np.concatenate([np.arange(voxels.first[b], voxels.first[b + 1]) for b in members])
        at = anatomy.grid.to_index(POSE.apply_array(blocks.grid.to_mm(voxels.place[rows].astype(float)))).T
        columns = [
            ndimage.map_coordinates(anatomy.values[..., c], at, order=1, mode="nearest")
            for c in range(channels)
        ]
        u = voxels.u[rows].astype(float)
        design = np.column_stack([*columns, np.ones(len(u))])
        residual = u - design @ np.linalg.lstsq(design, u, rcond=None)[0]
        assert scores[p] == pytest.approx(1 - residual.var() / u.var(), abs=5e-3)  # the ridge takes the rest


@pytest.mark.parametrize("channels", [2, 4])
def test_the_gradient_is_that_of_the_score(channels: int) -> None:
    blocks = ultrasound()
    with SliceThreads() as threads:
        whole = VolumeLc2(blocks, model(channels), threads)
        half = whole.restricted(blocks.centers_mm[:, 0] > 12.0)
        for metric in (whole, half):
            equations = metric.normal_equations(POSE, CENTER)
            expected = numeric(metric)
            slope = equations.slope
            assert slope.similarity == pytest.approx(metric.score(POSE).similarity, abs=1e-12)
            np.testing.assert_allclose(
                2 * slope.right / slope.weight, expected, atol=0.01 * np.abs(expected).max()
            )
            assert np.linalg.eigvalsh(equations.matrix).min() > 0
