"""What the page of the registration study is given: groups, and the curves counted from the trials."""

import math
from pathlib import Path

import numpy as np
import pytest
from trial_lines import TEN, line

from dvf_ig.core import OutputError
from dvf_ig.study.registration.page import (
    capture_page,
    methods_of,
    reliability,
    roc_curve,
    success_curves,
    write_capture_page,
)


def test_groups_carry_near_starts_and_errors() -> None:
    page = capture_page([*TEN, line(11, 12.1, 0.5), {"seed": 30, "refused": "no pair"}])
    (row,) = page.groups
    assert row.near_success is not None
    assert (row.group.n, row.near_success.of, page.refused) == (11, 10, 1)
    assert sorted(row.errors_mm) == [0.5, 0.5, 0.8, 1.0, 1.5, 1.9, 2.0, 3.0, 10.0, math.inf]


def test_methods_are_ours_first() -> None:
    lines = [line(0, 1.0, 1.0, method="edges"), line(1, 1.0, 1.0), {"seed": 2, "refused": "no pair"}]
    assert methods_of(lines) == ("dvf_ig", "edges")


def test_success_curves_pool_motions() -> None:
    lines = [line(0, 1.0, 1.0), line(1, 1.0, 9.0, motion="other"), line(2, 1.0, 1.0, condition="RR +5 %")]
    pooled, other = success_curves(lines)
    assert (pooled.condition, other.condition) == ("", "RR +5 %")
    assert [(b.success.of, b.success.share) for b in pooled.bins] == [(2, 0.5)]


def test_the_roc_goes_over_every_limit() -> None:
    found = roc_curve("dvf_ig", TEN)
    assert found is not None
    path = np.column_stack([found.refused_percent, found.caught_percent])
    assert path == pytest.approx(np.array([(0, 0), (0, 50), (20, 50), (100, 100)]))
    assert found.chosen_percent == pytest.approx((20, 50))
    assert found.failures == 2
    assert found.area == pytest.approx(0.7)


def test_reliability_is_counted_in_tenths() -> None:
    found = reliability("dvf_ig", TEN)
    assert found is not None
    assert found.mean_stated == pytest.approx([0.1, 0.3, 0.9])
    assert [share.share for share in found.success] == pytest.approx([0.0, 1.0, 0.5])


def test_a_method_that_states_nothing_has_no_curves() -> None:
    silent = [line(0, 1.0, 1.0, success_probability=None)]
    assert roc_curve("dvf_ig", silent) is None
    assert reliability("dvf_ig", silent) is None


def test_the_page_is_written_or_refused(tmp_path: Path) -> None:
    write_capture_page(TEN, tmp_path / "page.html")
    assert "10 registrations" in (tmp_path / "page.html").read_text()
    with pytest.raises(OutputError, match="cannot write"):
        write_capture_page(TEN, tmp_path / "missing" / "page.html")
