"""Pose and change of shape together: exact where nothing changes, better than a rigid fit elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.core import HEART_RADIUS_MM, FloatArray
from dvf_ig.registration.pose_chart import rigid_motion
from dvf_ig.registration.shape.blocks import SHIFT, BlockCosts, about_no_shift, none_negative
from dvf_ig.registration.shape.fit import OWN_MM, RMS_MM, JointFit, deformation_factor, joint_fit

CENTER_MM = np.array([10.0, -5.0, 30.0])
STIFFNESS = 25.0
"""Of a block, 1/mm²: its place is seen to 0.2 mm."""
NOTHING_KNOWN = np.diag([0.0] * 6 + [1.0])


def places(count: int, seed: int) -> FloatArray:
    """Over one side of the heart only, as a probe sees it."""
    inside = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3)) * [35.0, 35.0, 12.0]
    return np.asarray(CENTER_MM + inside + [0.0, 0.0, 22.0])


def costs_of(at_mm: FloatArray, shifts_mm: FloatArray) -> BlockCosts:
    """Blocks that are seen `shifts_mm` (n, 3) from where the pose puts them."""
    jacobian = np.concatenate([rigid_motion(at_mm, CENTER_MM), np.zeros((len(at_mm), 3, 1))], axis=2)
    gradient = -STIFFNESS * np.einsum("bdu,bd->bu", jacobian, shifts_mm)
    return BlockCosts(gradient, STIFFNESS * np.einsum("bdu,bdv->buv", jacobian, jacobian))


def fit_of(at_mm: FloatArray, costs: BlockCosts, known: FloatArray = NOTHING_KNOWN) -> JointFit:
    return joint_fit(costs, deformation_factor(at_mm, CENTER_MM), known, np.zeros(7))


def fitted(at_mm: FloatArray, shifts_mm: FloatArray) -> FloatArray:
    return fit_of(at_mm, costs_of(at_mm, shifts_mm)).step_mm


def test_a_rigid_motion_is_found_as_it_is() -> None:
    at, motion = places(40, 0), np.array([1.0, -2.0, 0.5, 3.0, 1.0, -2.0])
    found = fitted(at, rigid_motion(at, CENTER_MM) @ motion)
    np.testing.assert_allclose(found, motion, atol=1e-6)


def steps_under_a_change(own_mm: float) -> tuple[list[float], list[float], list[float]]:
    """Lengths of rigid and of joint steps that are to be none, and the latter's squares by their covariance.

    Args:
        own_mm: standard deviation of what each block is moved by besides the smooth change of shape.
    """
    rigid, joint, claimed = [], [], []
    for seed in range(60):
        at = places(40, seed)
        factor, rng = deformation_factor(at, CENTER_MM), np.random.default_rng(1000 + seed)
        change = factor @ rng.normal(size=factor.shape[2]) + own_mm * rng.normal(size=(len(at), 3))
        motion = rigid_motion(at, CENTER_MM).reshape(-1, 6)
        rigid.append(float(np.linalg.norm(np.linalg.lstsq(motion, change.ravel(), rcond=None)[0])))
        found = fit_of(at, costs_of(at, change))
        joint.append(float(np.linalg.norm(found.step_mm)))
        claimed.append(float(found.step_mm @ np.linalg.solve(found.covariance_mm2, found.step_mm)))
    return rigid, joint, claimed


def test_a_smooth_change_of_shape_moves_the_pose_less_than_a_rigid_fit() -> None:
    rigid, joint, _ = steps_under_a_change(own_mm=0.0)
    assert np.mean(joint) < 0.85 * np.mean(rigid)


def test_the_covariance_is_right_where_blocks_also_move_on_their_own() -> None:
    _, _, claimed = steps_under_a_change(own_mm=OWN_MM)
    assert 5.0 < np.mean(claimed) < 7.0


def test_the_fit_of_shifted_blocks_is_that_of_blocks_in_place() -> None:
    """An exact quadratic may be expanded anywhere."""
    at, rng = places(30, 8), np.random.default_rng(9)
    costs, shift = costs_of(at, rng.normal(size=(30, 3))), rng.normal(size=(30, 3))
    moved = replace(
        costs, gradient=costs.gradient + np.einsum("bud,bd->bu", costs.curvature[:, :, SHIFT], shift)
    )
    here, there = (fit_of(at, given) for given in (costs, about_no_shift(moved, shift)))
    np.testing.assert_allclose(here.step_mm, there.step_mm, atol=1e-9)
    np.testing.assert_allclose(here.shift_mm, there.shift_mm, atol=1e-9)


def test_the_pull_of_each_block_adds_up_to_the_step() -> None:
    at = places(30, 3)
    costs = costs_of(at, np.random.default_rng(4).normal(size=(30, 3)))
    found = fit_of(at, costs)
    np.testing.assert_allclose(-np.einsum("bpu,bu->p", found.pull, costs.gradient), found.step_mm, atol=1e-9)


def test_what_is_known_of_the_pose_counts() -> None:
    at = places(30, 5)
    costs = costs_of(at, np.full((30, 3), 2.0))
    known = np.diag([1e9] * 6 + [1.0])
    assert np.abs(fit_of(at, costs, known).step_mm).max() < 1e-3


def test_the_prior_has_its_size_and_no_rigid_part() -> None:
    edge = np.linspace(-HEART_RADIUS_MM, HEART_RADIUS_MM, 5)
    nodes = CENTER_MM + np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
    factor = deformation_factor(nodes, CENTER_MM)
    variance = (factor**2).sum(axis=(1, 2))
    assert 0.3 * RMS_MM**2 < variance.mean() < RMS_MM**2  # less what its rigid part took
    moved = np.linalg.pinv(rigid_motion(nodes, CENTER_MM).reshape(-1, 6)) @ factor.reshape(len(nodes) * 3, -1)
    assert np.abs(moved).max() < 0.05


def test_negative_curvature_is_left_out() -> None:
    matrix = np.diag([2.0, -1.0])[None]
    np.testing.assert_allclose(none_negative(matrix), np.diag([2.0, 0.0])[None], atol=1e-12)
    assert none_negative(np.zeros((0, 3, 3))).shape == (0, 3, 3)


@pytest.mark.parametrize("count", [5, 60])
def test_any_number_of_blocks(count: int) -> None:
    at = places(count, 7)
    assert np.isfinite(fitted(at, np.ones((count, 3)))).all()
