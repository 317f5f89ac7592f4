"""Covariance by leaving out blocks of time: closed forms, exact refits, intervals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvf_ig.calibration import MapUncertainty
from dvf_ig.calibration.probe.covariance import BLOCKS, block_jackknife, time_blocks
from dvf_ig.calibration.probe.map_parameters import MapParameters
from dvf_ig.core import ImageMap, InvalidInputError, Rigid

MAP = ImageMap(
    Rigid.from_rotation_vector([0.4, -0.9, 1.1], [11.0, 48.0, -2.0], "probe", "image"), np.array([0.2, 0.1])
)
CENTER = np.array([300.0, 250.0])


def test_the_mean_of_equal_blocks_has_the_textbook_variance() -> None:
    values = np.random.default_rng(0).standard_normal((40, 1))
    covariance, held_out = block_jackknife(np.ones((40, 1, 1)), values - values.mean())
    means = values.reshape(BLOCKS, -1).mean(axis=1)
    assert covariance[0, 0] == pytest.approx(means.var(ddof=1) / BLOCKS)
    without = [v - np.delete(values, i).mean() for i, v in enumerate(values.ravel())]
    np.testing.assert_allclose(held_out.ravel(), without)


def test_a_linear_fit_is_left_out_exactly() -> None:
    rng = np.random.default_rng(1)
    rows, right = rng.standard_normal((47, 3, 4)), rng.standard_normal((47, 3))

    def fit(keep: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(rows[keep].reshape(-1, 4), right[keep].ravel(), rcond=None)[0]

    everything = np.arange(47)
    whole = fit(everything)
    covariance, held_out = block_jackknife(rows, rows @ whole - right)
    refits = np.array([fit(np.setdiff1d(everything, block)) for block in time_blocks(47)])
    spread = refits - refits.mean(axis=0)
    np.testing.assert_allclose(covariance, (BLOCKS - 1) / BLOCKS * spread.T @ spread, rtol=1e-9)
    np.testing.assert_allclose(held_out[8], rows[8] @ fit(np.delete(everything, 8)) - right[8], rtol=1e-9)


def test_errors_shared_by_a_block_of_time_are_not_averaged_away() -> None:
    rng = np.random.default_rng(2)
    shared = np.repeat(rng.standard_normal(BLOCKS), 20)
    residuals = (shared + 0.1 * rng.standard_normal(200))[:, None]
    residuals -= residuals.mean()
    covariance, _ = block_jackknife(np.ones((200, 1, 1)), residuals)
    assert covariance[0, 0] > 5 * residuals.var() / 200


def test_one_block_that_decides_alone_is_refused() -> None:
    rows = np.zeros((40, 1, 2))
    rows[:, 0, 0] = 1.0
    rows[3, 0, 1] = 1.0
    with pytest.raises(InvalidInputError, match="one block"):
        block_jackknife(rows, np.ones((40, 1)))
    with pytest.raises(InvalidInputError, match="2 frames"):
        block_jackknife(rows[:2], np.ones((2, 1)))


@given(st.lists(st.floats(-0.2, 0.2), min_size=8, max_size=8), st.booleans())
def test_step_to_undoes_stepped(step: list[float], isotropic: bool) -> None:
    parameters = MapParameters(MAP, CENTER, isotropic)
    taken = np.array(step[: parameters.count])
    back = parameters.step_to(parameters.stepped(taken))
    np.testing.assert_allclose(back, np.append(taken, taken[6:])[:8] if isotropic else taken, atol=1e-9)


@pytest.mark.parametrize("isotropic", [False, True])
def test_jacobian_is_the_derivative_of_where_pixels_lie(isotropic: bool) -> None:
    parameters = MapParameters(MAP, CENTER, isotropic)
    pixel = np.array([[80.0, 420.0]])
    slope = parameters.jacobian(pixel)[0]
    for k in range(parameters.count):
        step = 1e-6 * np.eye(parameters.count)[k]
        ends = [parameters.stepped(s).apply_pixels(pixel).xyz_mm[0] for s in (step, -step)]
        numeric = MAP.rigid.rotation.T @ (ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(slope[:, k], numeric, atol=1e-6)


def test_a_rotation_moves_points_by_its_lever_and_the_centre_not_at_all() -> None:
    covariance = np.zeros((8, 8))
    covariance[0, 0] = np.radians(1.0) ** 2
    spread = MapUncertainty(MapParameters(MAP, CENTER), covariance, 100, np.ones(100))
    np.testing.assert_allclose(spread.center_mm, 0.0)
    below = CENTER + np.array([0.0, 500.0])
    # 500 px of 0.1 mm below the centre, 1° about the lateral axis: 50 mm · 0.01745 out of the plane
    np.testing.assert_allclose(
        spread.point_mm(below), [0, 0, spread.coverage_factor * 50.0 * np.radians(1.0)], atol=1e-12
    )
    np.testing.assert_allclose(spread.about(below).center_mm, spread.point_mm(below), atol=1e-12)
    assert spread.rotation_deg[0] == pytest.approx(2.262, abs=1e-3)


def test_covers_measures_the_truth_in_half_widths() -> None:
    covariance = np.diag([0.01, 0.01, 0.01, 0.5, 0.5, 0.5, 0.02, 0.02]) ** 2
    spread = MapUncertainty(MapParameters(MAP, CENTER), covariance, 100, np.ones(100))
    rigid = MAP.rigid
    rotation = rigid.rotation @ Rotation.from_rotvec([0.0, 0.01 * spread.coverage_factor, 0.0]).as_matrix()
    center = MAP.apply_pixels(CENTER[None]).xyz_mm[0]
    origin = center - rotation[:, :2] @ (CENTER * MAP.scale_mm_per_px)
    truth = ImageMap(Rigid("probe", "image", rotation, origin), MAP.scale_mm_per_px)
    np.testing.assert_allclose(spread.covers(truth), [0, 1, 0, 0, 0, 0, 0, 0], atol=1e-9)
