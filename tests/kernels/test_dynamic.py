"""The phase bracket of the servo kernel against CycleTiming.bracket."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import CycleTiming
from dvf_ig.kernels.phase import phase_bracket

fractions = st.lists(
    st.integers(0, 9999).map(lambda k: k / 10000.0), min_size=2, max_size=30, unique=True
).map(sorted)


@given(fractions, st.floats(-3.0, 3.0))
def test_bracket_is_that_of_the_timing(times, phi):
    timing = CycleTiming(np.array(times), 0.8)
    first, second, alpha, _ = phase_bracket(timing.fractions, 0, len(times), phi)
    expected_first, expected_second, expected_alpha = timing.bracket(phi)
    assert (first, second) == (expected_first, expected_second)
    assert abs(alpha - expected_alpha) < 1e-9


@given(fractions, st.floats(-1e6, 1e6))
def test_weight_stays_between_zero_and_one(times, phi):
    _, _, alpha, _ = phase_bracket(np.array(times), 0, len(times), phi)
    assert 0.0 <= alpha <= 1.0
