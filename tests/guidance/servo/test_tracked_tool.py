"""A tracked tool as the servo reads it: predicted between poses, without steps, never far ahead."""

import ctypes

import numpy as np
import pytest

from dvf_ig.guidance.devices.tracked import TrackedTool
from dvf_ig.kernels.servo.tracked import FARTHEST_MM, LONGEST_S, SMOOTHED_S

READ = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int64, ctypes.POINTER(ctypes.c_double))


def read(tool: TrackedTool, t_s: float) -> np.ndarray:
    out = (ctypes.c_double * 3)()
    assert READ(int(tool.functions[0]))(tool.context.ctypes.data, round(1e9 * t_s), out) == 0
    return np.array(out)


def moving(t_s: float, x_mm: float = 0.0) -> TrackedTool:
    tool = TrackedTool()
    tool.publish(np.array([x_mm, 2.0, 3.0]), np.array([20.0, 0.0, -10.0]), t_s)
    return tool


def test_tip_moves_on_between_poses():
    tool = moving(5.0)
    np.testing.assert_allclose(read(tool, 5.01), [0.2, 2.0, 2.9], atol=1e-9)
    np.testing.assert_allclose(read(tool, 4.9), [0.0, 2.0, 3.0], atol=1e-9)


def test_tip_is_predicted_no_further_than_its_poses_are_good_for():
    np.testing.assert_allclose(read(moving(5.0), 9.0), [20.0 * LONGEST_S, 2.0, 3.0 - 10.0 * LONGEST_S])


def test_new_pose_is_gone_over_to_without_a_step():
    tool = moving(5.0)
    before = read(tool, 5.010)
    tool.publish(np.array([0.7, 2.0, 2.9]), np.array([20.0, 0.0, -10.0]), 5.010)
    at = read(tool, 5.011)
    assert np.linalg.norm(at - before) < 0.025 + 0.5 / SMOOTHED_S * 1e-3
    steps = [read(tool, 5.011 + k * 1e-3) for k in range(1, 40)]
    assert max(np.linalg.norm(b - a) for a, b in zip([at, *steps], steps, strict=False)) < 0.13
    np.testing.assert_allclose(steps[-1], [0.7 + 20.0 * 0.040, 2.0, 2.9 - 10.0 * 0.040], atol=1e-3)


def test_pose_that_is_far_off_counts_at_once():
    tool = moving(5.0)
    read(tool, 5.0)
    tool.publish(np.array([2.0 * FARTHEST_MM, 2.0, 3.0]), np.zeros(3), 5.01)
    np.testing.assert_allclose(read(tool, 5.01), [2.0 * FARTHEST_MM, 2.0, 3.0], atol=1e-6)


@pytest.mark.parametrize("t_s", [0.5, 7.0])
def test_before_the_first_pose_it_answers(t_s):
    np.testing.assert_array_equal(read(TrackedTool(), t_s), np.zeros(3))
