"""The page skeleton: self-contained, and plain text stays plain text."""

from matplotlib.figure import Figure

from dvf_ig.report.page import html_page, image_tag, section, table


def test_plain_text_is_escaped() -> None:
    page = html_page("A < B", section("C & D", "<note>", table(("<h>",), [("x > 1",)])), style="p { }")
    assert "<title>A &lt; B</title>" in page
    assert "<h1>A &lt; B</h1>" in page
    assert "<h2>C &amp; D</h2><p class=note>&lt;note&gt;</p>" in page
    assert "<th>&lt;h&gt;</th>" in page
    assert "<td>x &gt; 1</td>" in page
    assert page.startswith("<!doctype html>")


def test_images_lie_inside_the_page() -> None:
    tag = image_tag(Figure(figsize=(1.0, 1.0)), 'a "b"', width_px=50)
    assert tag.startswith('<img alt="a &quot;b&quot;" width="50" src="data:image/png;base64,')
