"""Mean, spread and quantiles of errors against sums by hand."""

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError, summarise_errors


def test_the_largest_twentieth_is_left_out_of_the_second_mean() -> None:
    # 1 ... 20 in any order: the lowest 95 % are 1 ... 19; variance of 1 ... n is n (n + 1) / 12
    found = summarise_errors(np.random.default_rng(0).permutation(20) + 1.0)
    assert (found.mean, found.mean95) == (10.5, 10.0)
    assert found.sd == pytest.approx(np.sqrt(20 * 21 / 12))
    assert found.sd95 == pytest.approx(np.sqrt(19 * 20 / 12))


def test_a_single_error_has_no_spread() -> None:
    found = summarise_errors(np.array([3.0]))
    assert (found.mean, found.sd, found.mean95, found.sd95) == (3.0, 0.0, 3.0, 0.0)


def test_quantiles() -> None:
    found = summarise_errors(np.array([1.0, 2.0, 3.0, 10.0]))
    assert found.tre_fields() == {"mean": 4.0, "median": 2.5, "p95": pytest.approx(8.95), "max": 10.0, "n": 4}


def test_nothing_to_summarise_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="at least one"):
        summarise_errors(np.array([]))
