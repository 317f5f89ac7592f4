"""The summary of registration trials on made-up lines whose numbers are known by hand."""

import json
import math
from typing import Any

import numpy as np
import pytest
from trial_lines import TEN, line

from dvf_ig.io import plain
from dvf_ig.study.registration.capture import capture_of
from dvf_ig.study.registration.summary import Group, auc_of, summarise_trials
from dvf_ig.study.share import share_of


def only(groups: list[Group]) -> Group:
    (group,) = groups
    return group


def test_a_group_counts_every_run() -> None:
    group = only(summarise_trials(reversed(TEN)))
    assert (group.experiment, group.motion, group.quality, group.method, group.condition) == (
        "B",
        "calm",
        "standard",
        "dvf_ig",
        "",
    )
    assert (group.n, group.refused, group.pairs) == (10, 1, 2)
    shares = (group.success, group.strict, group.between, group.failure)
    assert [(share.count, share.of) for share in shares] == [(5, 10), (2, 10), (2, 10), (2, 10)]
    # 0.5 0.8 1.0 1.5 1.9 2.0 3.0 10.0 and one lost, which is larger than all
    assert (group.tre_mm.n, group.tre_mm.median, group.tre_mm.p95, group.tre_mm.max) == (9, 1.9, None, None)
    successes = group.success_tre_mm
    assert (successes.n, successes.median, successes.max) == (5, 1.0, 1.9)
    assert successes.p95 == pytest.approx(1.5 + 0.8 * 0.4)
    assert group.rotation_deg.n == 8
    assert group.rotation_deg.median == pytest.approx(2 * (1.5 + 1.9) / 2)
    assert group.translation_mm == pytest.approx((1.7, 0.85, 0.0))
    assert (group.seconds.median, group.seconds.max) == (0.5, 1.5)


def test_the_self_check_is_of_failures_and_successes() -> None:
    check = only(summarise_trials(TEN)).check
    assert check.failures_flagged is not None
    assert check.successes_flagged is not None
    assert check.released_failures is not None
    assert (check.failures_flagged.count, check.failures_flagged.of) == (1, 2)
    assert (check.successes_flagged.count, check.successes_flagged.of) == (1, 5)
    assert (check.released_failures.count, check.released_failures.of) == (1, 7)
    # failures 0.1 and 0.9 against four 0.9 and one 0.3: 5 wins and 4 ties in 10 pairs
    assert check.auc == pytest.approx((5 + 4 / 2) / 10)
    silent = [line(s, 1.0, 1.0 + 3 * s, usable=None, success_probability=None) for s in range(2)]
    check = only(summarise_trials(silent)).check
    assert (check.failures_flagged, check.successes_flagged, check.released_failures) == (None, None, None)
    assert check.auc is None


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


def runs(wins: int, of: int, start_mm: float) -> list[dict[str, Any]]:
    return [line(k, start_mm, 1.0 if k < wins else 9.0) for k in range(of)]


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        (runs(20, 20, 0.0) + runs(19, 20, 4.0) + runs(18, 20, 4.1), "4 mm"),
        (runs(1, 2, 0.5), "0 mm"),
        (runs(20, 20, 2.0) + runs(20, 20, 4.0000001), "≥ 4 mm"),
        (runs(20, 20, 2.0) + runs(20, 20, 4.001), "≥ 2 mm"),
        (runs(3, 3, 1.0) + runs(3, 3, 7.0) + runs(0, 3, 9.0), "≥ 2 mm"),
        ([], "–"),
    ],
)
def test_capture_range(lines: list[dict[str, Any]], text: str) -> None:
    assert str(capture_of(lines)) == text


def test_bins_hold_their_upper_edge_and_refused_runs() -> None:
    bins = capture_of(TEN).bins
    assert [(b.low_mm, b.high_mm, b.success.count, b.success.of) for b in bins] == [
        (0, 2, 2, 2),
        (2, 4, 2, 2),
        (4, 6, 0, 2),
        (8, 10, 0, 1),
        (10, 12, 1, 3),
    ]
    assert str(capture_of(TEN)) == "4 mm"


def test_a_bound_leaves_out_further_starts_but_no_refusal_without_one() -> None:
    lines = [*TEN, {"seed": 10, "refused": "no pair"}, line(11, 12.1, 0.5)]
    near, nameless = summarise_trials(lines, up_to_mm=12.0)
    assert (near.n, near.success.count) == (10, 5)
    assert (nameless.method, nameless.n, nameless.refused, nameless.success.count) == ("", 1, 1, 0)
    assert nameless.tre_mm.median is None
    assert only(summarise_trials(TEN, up_to_mm=4.0)).n == 4


def test_groups_come_in_the_order_of_their_seeds_and_are_json() -> None:
    lines = [line(3, 1.0, 1.0), line(1, 1.0, 1.0, condition="RR +5 %"), line(2, 1.0, 4.0, method="edges")]
    groups = summarise_trials(lines)
    assert [(g.method, g.condition) for g in groups] == [("dvf_ig", "RR +5 %"), ("edges", ""), ("dvf_ig", "")]
    text = json.dumps(plain(summarise_trials([*TEN, *lines])), allow_nan=False)
    assert json.loads(text)[0]["tre_mm"]["max"] is None
    assert summarise_trials([]) == []
