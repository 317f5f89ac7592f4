"""Scalar laws of the kernels against their NumPy references, and the fade where the direction is lost."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.guidance import Gaussian, Sigmoid
from dvf_ig.kernels.laws import GAUSSIAN, SIGMOID, direction_certainty, signed_potential

distances = st.floats(-200.0, 200.0)


@given(distances, st.floats(0.05, 5.0))
def test_sigmoid_twin(distance, gamma):
    expected = Sigmoid(gamma).potential(np.array([distance]))[0]
    assert signed_potential(SIGMOID, gamma, 1.0, distance) == pytest.approx(expected, abs=1e-14)


@given(distances, st.floats(0.1, 20.0), st.sampled_from([0.5, 1.0, 1.7, 2.0, 4.0]))
def test_gaussian_twin(distance, delta, m):
    expected = Gaussian(delta, m).potential(np.array([distance]))[0]
    assert signed_potential(GAUSSIAN, delta, m, distance) == pytest.approx(expected, abs=1e-13)


def test_extreme_distances_saturate_without_a_nan():
    assert signed_potential(SIGMOID, 5.0, 1.0, -1e6) == 0.0
    assert signed_potential(SIGMOID, 5.0, 1.0, 1e6) == 1.0
    assert signed_potential(GAUSSIAN, 1.0, 4.0, -1e300) == -1.0
    assert signed_potential(GAUSSIAN, 1.0, 1.0, 0.0) == 0.0


def test_certainty_is_a_smoothstep_from_02_to_04():
    assert direction_certainty(0.0) == direction_certainty(0.2) == 0.0
    assert direction_certainty(0.4) == direction_certainty(1.0) == 1.0
    assert direction_certainty(0.3) == pytest.approx(0.5)
    step = 1e-6
    assert abs(direction_certainty(0.2 + step)) < 1e-9
    assert math.isclose(direction_certainty(0.25), 0.15625)
