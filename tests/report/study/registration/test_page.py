"""The page and the figures of the registration study hold the numbers they are given."""

import base64
import re

import pytest
from drawn_lines import x_of, y_of
from trial_lines import TEN, line

from dvf_ig.report.study.registration import capture_html
from dvf_ig.report.study.registration.capture import capture_curves, colors_of, error_boxes
from dvf_ig.report.study.registration.checks import reliability_figure, roc_figure
from dvf_ig.report.style import ESTIMATE
from dvf_ig.study.registration.page import capture_page


def test_the_page_shows_these_numbers_and_is_self_contained() -> None:
    others = [
        line(20 + k, 2.0 * k, 4.0, method="<edges>", usable=None, success_probability=None) for k in range(3)
    ]
    page = capture_html(capture_page([*TEN, *others, {"seed": 30, "refused": "no pair"}]))
    assert "13 registrations" in page
    assert "1 more trials were refused" in page
    assert (
        "<td class=n>10 (1 refused)<small>2</small></td><td class=n>50.0<small>23.7–76.3</small></td>" in page
    )
    assert "<td class=n>1.90<small>lost · lost</small></td>" in page
    assert "&lt;edges&gt;" in page
    assert "<edges>" not in page
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) == 4
    assert "NaN" not in re.sub(r"base64,[^\"]+", "", page)
    assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)


def test_a_page_of_nothing_and_of_refusals_alone_is_a_page() -> None:
    assert "0 registrations" in capture_html(capture_page([]))
    refused = [{"seed": 1, "method": "dvf_ig", "refused": "why"}]
    assert "1 registrations" in capture_html(capture_page(refused))


def test_figures_hold_the_numbers() -> None:
    page = capture_page(
        [*TEN, *(line(20 + k, 1.0, 4.0, method="edges", condition="RR +5 %") for k in range(3))]
    )
    colors = colors_of(page.methods)
    assert colors["dvf_ig"] == ESTIMATE != colors["edges"]
    curves = capture_curves(page.success, colors, page.limits)
    assert curves is not None
    assert [panel.get_title() for panel in curves.axes] == ["", "RR +5 %"]
    shares = curves.axes[0].containers[0].lines[0].get_ydata()  # type: ignore[attr-defined]
    assert shares == pytest.approx([100, 100, 0, 0, 100 / 3])
    ours = page.groups[0].errors_mm
    boxes = error_boxes([("ours", "dvf_ig", ours), ("refused", "dvf_ig", ours[:0])], colors, page.limits)
    assert boxes is not None
    assert [text.get_text() for text in boxes.axes[0].get_yticklabels()] == ["ours  (n = 9)"]
    assert error_boxes([("refused", "dvf_ig", ours[:0])], colors, page.limits) is None
    assert capture_curves([], colors, page.limits) is None


def test_figures_of_the_self_check_hold_the_numbers() -> None:
    page = capture_page(TEN)
    colors = colors_of(page.methods)
    roc = roc_figure(page.roc, colors, page.limits)
    assert roc is not None
    curve, ring = roc.axes[0].lines[:2]
    assert curve.get_ydata() == pytest.approx(page.roc[0].caught_percent)
    assert (x_of(ring)[0], y_of(ring)[0]) == pytest.approx((20, 50))
    told = reliability_figure(page.reliability, colors, page.limits)
    assert told is not None
    x, y = told.axes[0].containers[0].lines[0].get_data()  # type: ignore[attr-defined]
    assert x == pytest.approx([10, 30, 90])
    assert y == pytest.approx([0, 100, 50])
    assert roc_figure([], colors, page.limits) is None
    assert reliability_figure([], colors, page.limits) is None
