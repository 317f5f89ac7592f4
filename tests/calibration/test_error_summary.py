"""Mean and spread of errors against sums by hand."""

import numpy as np
import pytest

from dvf_ig.calibration.error_summary import summarise


def test_the_largest_twentieth_is_left_out_of_the_second_mean() -> None:
    # 1 ... 20 in any order: the lowest 95 % are 1 ... 19; variance of 1 ... n is n (n + 1) / 12
    found = summarise(np.random.default_rng(0).permutation(20) + 1.0)
    assert (found.mean_mm, found.mean95_mm) == (10.5, 10.0)
    assert found.sd_mm == pytest.approx(np.sqrt(20 * 21 / 12))
    assert found.sd95_mm == pytest.approx(np.sqrt(19 * 20 / 12))


def test_a_single_error_has_no_spread() -> None:
    found = summarise(np.array([3.0]))
    assert (found.mean_mm, found.sd_mm, found.mean95_mm, found.sd95_mm) == (3.0, 0.0, 3.0, 0.0)
