"""Phase between two known R peaks, and which beats are regular."""

import numpy as np

from dvf_ig.cardiac import beat_phase

STEADY = np.arange(12) * 0.8


def test_phase_is_the_share_of_the_enclosing_interval() -> None:
    found = beat_phase(STEADY, np.array([0.0, 0.2, 0.8, 8.6]))
    np.testing.assert_allclose(found.phi, [0.0, 0.25, 0.0, 0.75], atol=1e-12)
    np.testing.assert_allclose(found.rr_s, 0.8)
    assert found.regular.all()


def test_before_the_first_and_after_the_last_peak_there_is_no_phase() -> None:
    found = beat_phase(STEADY, np.array([-0.1, 8.81]))
    assert not found.regular.any()
    assert np.isnan(found.rr_s).all()
    assert not beat_phase(STEADY[:1], np.array([0.1])).regular.any()


def test_an_early_beat_its_pause_and_the_beat_after_are_not_regular() -> None:
    peaks = STEADY.copy()
    peaks[6] -= 0.3
    found = beat_phase(peaks, peaks[:-1] + 0.1)
    np.testing.assert_array_equal(np.flatnonzero(~found.regular), [5, 6, 7])
