"""The second world's retiming: nothing at the rate of the MR, increasing, and not the first world's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_synth import two_segment_phase
from data_synth.second_world.clock import CycleLaw, NoisyClock
from dvf_ig.core import InvalidInputError

LAW = CycleLaw(0.86, 0.36, 0.45, 0.3, 0.2)
PHI = np.linspace(0.0, 1.0, 400, endpoint=False)


def test_knots_lie_where_the_powers_of_rr_put_them() -> None:
    for rr in (0.5, 0.86, 1.2):
        systole = 0.36 * 0.86 * (rr / 0.86) ** 0.3
        filling = 0.64 * 0.86 * 0.45 * (rr / 0.86) ** 0.2
        squeeze = min(1.0, 0.92 * rr / (systole + filling))
        at = np.array([systole, systole + filling]) * squeeze / rr
        np.testing.assert_allclose(LAW.model_phase(at, np.full(2, rr)), [0.36, 0.36 + 0.64 * 0.45], atol=1e-9)


def test_at_the_rate_of_the_mr_nothing_is_retimed() -> None:
    np.testing.assert_allclose(LAW.model_phase(PHI, np.full(len(PHI), 0.86)), PHI, atol=1e-12)


@given(st.floats(0.35, 1.6), st.floats(0.12, 0.55), st.floats(0.0, 0.5), st.floats(0.35, 0.6))
def test_phase_increases_through_every_beat(rr: float, systole: float, filling: float, share: float) -> None:
    phase = CycleLaw(0.86, 0.36, share, systole, filling).model_phase(PHI, np.full(len(PHI), rr))
    assert (np.diff(phase) > 0).all()
    assert phase[0] == 0.0
    assert phase[-1] < 1.0


def test_it_is_another_law_than_the_first_worlds() -> None:
    rr = np.full(len(PHI), 0.6)
    assert np.abs(LAW.model_phase(PHI, rr) - two_segment_phase(PHI, rr, 0.86, 0.36)).max() > 0.02


def test_muscle_follows_its_own_beats_and_phi_the_ecg() -> None:
    peaks = np.array([0.0, 0.9, 1.7, 2.6])
    clock = NoisyClock(peaks, np.array([0.0, 0.02, -0.01, 0.0]), LAW)
    np.testing.assert_allclose(clock.phi(peaks[:-1]), 0.0, atol=1e-12)
    assert clock.model_phase(np.array([0.92])) == pytest.approx(0.0, abs=1e-9)
    assert clock.model_phase(np.array([[0.9]]))[0, 0] > 0.9
    assert clock.model_phase(np.array([-5.0, 9.0])).shape == (2,)


@pytest.mark.parametrize("delays", [[0.0], [0.0, -1.0, 0.0]])
def test_impossible_beats_are_refused(delays: list[float]) -> None:
    with pytest.raises(InvalidInputError, match="increasing"):
        NoisyClock(np.array([0.0, 0.9, 1.7]), np.array(delays), LAW)
