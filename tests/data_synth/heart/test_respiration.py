"""Breathing: rests at end-expiration, keeps its excursion and rate, off by default."""

import numpy as np
import pytest

from data_synth.heart.respiration import breathing, respiration_mm
from dvf_ig.core import InvalidInputError


def test_excursion_rate_and_rest() -> None:
    t_s = np.linspace(0, 60, 60_001)
    moved = respiration_mm(t_s, 12.0, 15.0)
    assert moved.min() == pytest.approx(0.0, abs=1e-6)
    assert moved.max() == pytest.approx(12.0)
    assert np.allclose(moved, respiration_mm(t_s + 4.0, 12.0, 15.0))
    # cos⁴ has mean 3/8: more than half of the time below it, near end-expiration
    assert moved.mean() == pytest.approx(12.0 * 3 / 8, rel=1e-3)
    assert (moved < 0.25 * 12.0).mean() == pytest.approx(0.5, abs=0.01)


def test_heart_moves_down_along_one_line() -> None:
    path = breathing(10.0, 12.0, np.random.default_rng(0))(np.linspace(0, 5, 501))
    assert path.shape == (501, 3)
    assert np.linalg.norm(path, axis=1).max() == pytest.approx(10.0, rel=1e-3)
    assert (path[:, 2] <= 0).all()
    assert np.linalg.matrix_rank(path, tol=1e-9) == 1


def test_no_breathing_without_excursion_and_bad_ones_are_refused() -> None:
    assert not breathing(0.0, 14.0, np.random.default_rng(0))(np.arange(5.0)).any()
    with pytest.raises(InvalidInputError, match="needed 0 or more mm"):
        breathing(-1.0, 14.0, np.random.default_rng(0))
    with pytest.raises(InvalidInputError, match="positive rate"):
        breathing(1.0, 0.0, np.random.default_rng(0))
