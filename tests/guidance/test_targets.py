"""Line and path targets: closed forms, motion with phase, continuity where parts of a path compete."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import CycleTiming, InvalidInputError
from dvf_ig.guidance import DeviceLimits, Gaussian, PathFixture, PathTarget, Sigmoid, Status

LINE = PathTarget.static("mr", [[0.0, 0, -50], [0.0, 0, 50]])
HAIRPIN = PathTarget.static("mr", [[-20.0, 3, 0], [20.0, 3, 0], [20.0, -3, 0], [-20.0, -3, 0]])
LAW = Gaussian(3.0, 1.0)


@given(st.floats(-8, 8), st.floats(-8, 8), st.floats(-45, 45))
def test_a_line_pulls_straight_to_itself(x, y, z):
    samples = PathFixture(LINE, LAW).force(np.array([[x, y, z]]), 0.0)
    r = math.hypot(x, y)
    expected = -0.6 * -math.expm1(-((r / 3.0) ** 2)) * np.array([x, y, 0.0]) / max(r, 1e-300)
    assert samples.distance_mm[0] == pytest.approx(r, abs=1e-12)
    np.testing.assert_allclose(samples.force_n[0], expected, atol=1e-12)


def test_beyond_its_end_a_line_pulls_to_the_end():
    samples = PathFixture(LINE, LAW).force(np.array([[3.0, 0.0, 54.0]]), 0.0)
    assert samples.distance_mm[0] == pytest.approx(5.0)
    np.testing.assert_allclose(np.cross(samples.force_n[0], [3.0, 0.0, 4.0]), 0.0, atol=1e-12)


def test_beside_a_straight_path_of_many_points_the_pull_has_no_ripple():
    """Neighbouring parts share the nearest point's direction; their ends' directions cancel in the middle."""
    many = PathTarget.static("mr", np.column_stack([np.zeros((41, 2)), np.linspace(-50, 50, 41)]))
    points = np.column_stack([np.full(81, 2.0), np.zeros(81), np.linspace(-10, 10, 81)])
    got = PathFixture(many, LAW).force(points, 0.0)
    one = PathFixture(LINE, LAW).force(points, 0.0)
    np.testing.assert_allclose(got.distance_mm, one.distance_mm, atol=1e-12)
    assert np.linalg.norm(got.force_n - one.force_n, axis=1).max() < 0.12 * 0.6


def test_a_path_moves_with_the_phase():
    timing = CycleTiming(np.array([0.0, 0.5]), 0.8)
    points = np.array([[[0.0, 0, -50], [0.0, 0, 50]], [[4.0, 0, -50], [4.0, 0, 50]]])
    fixture = PathFixture(PathTarget("mr", points, timing), LAW)
    phase = np.array([0.0, 0.125, 0.25, 0.5, 0.75, 1.0])
    found = fixture.force(np.tile([6.0, 0.0, 0.0], (6, 1)), phase).distance_mm
    np.testing.assert_allclose(found, [6.0, 5.0, 4.0, 2.0, 4.0, 6.0], atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_the_pull_is_bounded_and_continuous_between_competing_parts(seed):
    rng = np.random.default_rng(seed)
    start = rng.uniform(-8, 8, 3) * np.array([2.5, 1.0, 1.0])
    direction = rng.normal(size=3)
    along = start + np.linspace(0, 2, 101)[:, None] * direction / np.linalg.norm(direction)
    force = PathFixture(HAIRPIN, LAW).force(along, 0.0).force_n
    assert np.linalg.norm(force, axis=1).max() <= 0.6 * (1 + 1e-12)
    # 20 µm: the weights turn by at most 2 · 2 a mm, the smoothstep adds 1.5/0.2 of that
    assert np.linalg.norm(np.diff(force, axis=0), axis=1).max() <= 0.6 * 0.02 * 40


def test_half_way_between_two_parts_there_is_no_direction_and_no_pull():
    samples = PathFixture(HAIRPIN, LAW).force(np.array([[0.0, 0.0, 0.0], [0.0, 2.9, 0.0]]), 0.0)
    np.testing.assert_allclose(samples.force_n[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(samples.distance_mm, [3.0, 0.1])


def test_faulty_points_get_no_force_and_say_so():
    points = np.array([[1.0, 0, 0], [np.nan, 0, 0], [1.0, 0, 0]])
    samples = PathFixture(LINE, LAW).force(points, np.array([0.1, 0.1, np.inf]))
    assert samples.status.tolist() == [Status.OK, Status.FAULT, Status.FAULT]
    assert not samples.force_n[1:].any()


def test_what_a_path_refuses():
    with pytest.raises(InvalidInputError, match="Sigmoid law"):
        PathFixture(LINE, Sigmoid())
    with pytest.raises(InvalidInputError, match="depth of 2 mm"):
        PathFixture(LINE, Gaussian(3.0, depth_mm=2.0))
    with pytest.raises(InvalidInputError, match="too stiff for the device"):
        PathFixture(LINE, LAW, device=DeviceLimits(stiffness_n_per_m=100.0))
    with pytest.raises(InvalidInputError, match="at least 2 points"):
        PathTarget.static("mr", [[0.0, 0, 0]])
    with pytest.raises(InvalidInputError, match="equal points"):
        PathTarget.static("mr", [[0.0, 0, 0], [0.0, 0, 0]])
    with pytest.raises(InvalidInputError, match="one phase without timing"):
        PathTarget("mr", np.zeros((2, 2, 3)))
