"""Statistics of trials, against values known by hand or from the literature."""

import math

import numpy as np
import pytest

from dvf_ig.study.statistics import Estimate, auc_of, estimate_text, share_of, share_text


def test_the_area_under_the_roc_is_that_of_all_pairs() -> None:
    rng = np.random.default_rng(4)
    bad, good = rng.integers(0, 6, 31) / 5, rng.integers(2, 8, 47) / 7
    pairs = (good[:, None] > bad).mean() + 0.5 * (good[:, None] == bad).mean()
    assert auc_of(bad.tolist(), [*good, math.nan]) == pytest.approx(pairs, abs=1e-12)


def test_intervals_are_those_of_wilson() -> None:
    # Newcombe 1998, table I: 81 of 263 and 0 of 20
    share = share_of(81, 263)
    assert share.low is not None
    assert share.high is not None
    assert (round(share.low, 4), round(share.high, 4)) == (0.2553, 0.3662)
    none = share_of(0, 20)
    assert none.low == pytest.approx(0, abs=1e-12)
    assert none.high == pytest.approx(0.1611, abs=5e-5)
    assert share_of(0, 0).share is None


def test_a_table_shows_what_is_known() -> None:
    assert share_text(share_of(81, 263)) == "81 of 263: 31% (26%–37%)"
    assert share_text(share_of(0, 0)) == "–"
    assert estimate_text(Estimate(1.0, 0.5, 2.0)) == "1.00 (0.50–2.00)"
    assert estimate_text(Estimate(1.0, None, None)) == "1.00"
    assert estimate_text(Estimate(None, None, None)) == "–"
