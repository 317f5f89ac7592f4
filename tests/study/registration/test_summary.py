"""The summary of registration trials on made-up lines whose numbers are known by hand, and its page."""

import base64
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dvf_ig.core import OutputError
from dvf_ig.io import plain
from dvf_ig.report.study.registration_capture import (
    OURS_COLOR,
    capture_curves,
    colors_of,
    error_boxes,
    methods_of,
)
from dvf_ig.report.study.registration_checks import calibration_picture, roc_picture
from dvf_ig.report.study.registration_page import capture_html, write_capture_page
from dvf_ig.study.registration.summary import Group, auc_of, capture_of, share_of, summarise_trials


def line(seed: int, start_mm: float | None, tre_mm: float | None, **other: Any) -> dict[str, Any]:
    return {
        "seed": seed,
        "pair": seed % 2,
        "motion": "calm",
        "quality": "standard",
        "arm": "B",
        "method": "dvf_ig",
        "condition": "",
        "start_mm": start_mm,
        "tre_mm": tre_mm,
        "rotation_deg": None if tre_mm is None else 2 * tre_mm,
        "translation_mm": None if tre_mm is None else [-tre_mm, tre_mm / 2, 0.0],
        "stop": "converged",
        "usable": True,
        "success_probability": 0.9,
        "seconds": 0.5,
        **other,
    }


TEN = [
    line(0, 1.0, 0.5),
    line(1, 2.0, 0.8),
    line(2, 3.0, 1.0),
    line(3, 3.5, 1.5),
    line(4, 5.0, 2.0),
    line(5, 6.0, 3.0),
    line(6, 9.0, 10.0, usable=False, success_probability=0.1),
    line(7, 11.0, None, stop="poor match", success_probability=0.9, seconds=1.5),
    line(8, 11.5, 1.9, usable=False, success_probability=0.3),
    {**line(9, 12.0, None), "refused": "no overlap", "tre_mm": None, "usable": None},
]


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


def test_the_page_shows_these_numbers_and_is_self_contained(tmp_path: Path) -> None:
    others = [
        line(20 + k, 2.0 * k, 4.0, method="<edges>", usable=None, success_probability=None) for k in range(3)
    ]
    lines = [*TEN, *others, {"seed": 30, "refused": "no pair"}]
    write_capture_page(lines, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "13 registrations" in page
    assert "1 more trials were refused" in page
    assert (
        "<td class=n>10 (1 refused)<small>2</small></td><td class=n>50.0<small>23.7–76.3</small></td>" in page
    )
    assert "<td class=n>1.90<small>lost · lost</small></td>" in page
    assert "&lt;edges&gt;" in page
    assert "<edges>" not in page
    assert "NaN" not in page
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) == 4
    assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)
    with pytest.raises(OutputError, match="cannot write"):
        write_capture_page(lines, tmp_path / "missing" / "page.html")


def test_a_page_of_nothing_and_of_refusals_alone_is_a_page() -> None:
    assert "0 registrations" in capture_html([])
    assert "1 registrations" in capture_html([{"seed": 1, "method": "dvf_ig", "refused": "why"}])


def test_pictures_hold_the_numbers() -> None:
    lines = [*TEN, *(line(20 + k, 1.0, 4.0, method="edges", condition="RR +5 %") for k in range(3))]
    colors = colors_of(lines)
    assert methods_of(lines) == ["dvf_ig", "edges"]
    assert colors["dvf_ig"] == OURS_COLOR != colors["edges"]
    curves = capture_curves(lines, colors)
    assert curves is not None
    assert [panel.get_title() for panel in curves.axes] == ["", "RR +5 %"]
    shares = curves.axes[0].containers[0].lines[0].get_ydata()  # type: ignore[attr-defined]
    assert shares == pytest.approx([100, 100, 0, 0, 100 / 3])
    boxes = error_boxes([("ours", TEN), ("refused", TEN[9:])], colors)
    assert boxes is not None
    assert [text.get_text() for text in boxes.axes[0].get_yticklabels()] == ["ours  (n = 9)"]
    assert error_boxes([("refused", TEN[9:])], colors) is None
    assert capture_curves([], colors) is None


def test_pictures_of_the_self_check_hold_the_numbers() -> None:
    colors = colors_of(TEN)
    roc = roc_picture(TEN, colors)
    assert roc is not None
    curve, ring = roc.axes[0].lines[:2]
    assert np.column_stack(curve.get_data()) == pytest.approx(
        np.array([(0, 0), (0, 50), (20, 50), (100, 100)])
    )
    assert np.column_stack(ring.get_data()) == pytest.approx(np.array([(20, 50)]))
    told = calibration_picture(TEN, colors)
    assert told is not None
    x, y = told.axes[0].containers[0].lines[0].get_data()  # type: ignore[attr-defined]
    assert x == pytest.approx([10, 30, 90])
    assert y == pytest.approx([0, 100, 50])
    silent = [line(0, 1.0, 1.0, success_probability=None)]
    assert roc_picture(silent, colors) is None
    assert calibration_picture(silent, colors) is None
