"""The page of a registration: outcome, planes, evidence, transform; one file that loads nothing."""

from dataclasses import replace

import numpy as np
import pytest
from html_outline import outline_of

from dvf_ig.core import Mesh, Warp
from dvf_ig.core.space.warp import knots
from dvf_ig.report.plane_marks import scale_bar_mm
from dvf_ig.report.plane_overlay import AnatomyPlane, PlaneOverlay
from dvf_ig.report.registration import Check, Outcome, RegistrationPage, Transform, registration_html
from dvf_ig.report.registration.page import checkerboard, checkerboard_figure, fused_figure, fused_rgb
from dvf_ig.report.registration.shape import shape_shown

TURN = np.array([[0.0, -1, 0, 5], [1, 0, 0, -7], [0, 0, 1, 9], [0, 0, 0, 1]])


def overlay(**changes: object) -> PlaneOverlay:
    """60 by 40 mm: the surface 10 mm below the top at the start, 20 mm registered; blood 5 mm below it."""
    y_mm = np.mgrid[:80, :60][0] * 0.5 + 0.25

    def anatomy(surface_mm: float) -> AnatomyPlane:
        grey = np.where(y_mm < surface_mm, 0.0, 1.0)
        return AnatomyPlane(grey, y_mm - surface_mm, y_mm - surface_mm - 5.0, ("R", "L", "A", "P"))

    given = PlaneOverlay(
        name="frame 3",
        plane="axial, tilted by 12°",
        event_s=2.5,
        model_phase=0.4,
        image=np.full((80, 60), 51, np.uint8),
        pixel_mm=(1.0, 0.5),
        start=anatomy(10.0),
        registered=anatomy(20.0),
    )
    return replace(given, **changes)


def page() -> RegistrationPage:
    return RegistrationPage(
        title="Registration of <toy>",
        about="patient nobody, dvf_ig 0",
        usable=True,
        reason="It converged.",
        stated=[("success probability", "0.96"), ("largest error over the heart", "below 3.1 mm, at 95 %")],
        planes=[overlay(), overlay(name="frame 9", event_s=None)],
        anatomy="MR",
        remark="",
        checks=[
            Check("Overlap", "share inside", "98 %", "at least 35 %", Outcome.PASSED),
            Check("Halves", "distance <of> halves", "7.00 mm", "at most 4 mm", Outcome.FAILED),
            Check("Parts", "distance of parts", "0.70 mm", "", Outcome.SHOWN),
            Check("Same patient", "mirrored", "", "", Outcome.NOT_CHECKED),
        ],
        findings=[("similarity", "0.4", "share")],
        data=[("frames", "48 of 50")],
        transform=Transform("mr", "tracker", "the MR", "the tracker", TURN, "pose.tfm"),
        made=[("seed", "3")],
    )


def test_the_page_is_one_wellformed_file_that_loads_nothing() -> None:
    text = registration_html(page())
    outline = outline_of(text)
    assert outline.faults == []
    assert len(outline.loaded) == 10
    assert all(entry.startswith("img data:image/jpeg;base64,") for entry in outline.loaded)
    assert "url(" not in text
    assert "http" not in text
    assert "<script" not in text
    alts = [image["alt"] for image in outline.images]
    assert len(set(alts)) == 10
    assert alts[1] == "frame 3, registered: ultrasound and the model's contours"  # which the slider uncovers
    assert alts[2] == "frame 3, registered: MR and the model's contours over ultrasound"
    assert "Registration of &lt;toy&gt;" in text
    assert "distance &lt;of&gt; halves" in text


def test_a_heart_of_another_shape_is_shown_beside_that_of_the_mr() -> None:
    """A box whose front is 3 mm further out, and whose upper part is not known."""
    corners = np.stack(np.meshgrid([-30.0, 30.0], [-20.0, 20.0], [-40.0, 40.0], indexing="ij"), axis=-1)
    front = np.array([[0, 4, 5], [0, 5, 1]])
    mesh = Mesh("mr", corners.reshape(-1, 3), np.concatenate([front, 7 - front]))
    origin, knot_mm = np.full(3, -84.0), 14.0
    places = knots(origin, knot_mm)
    pull = np.where(places[:, 1:2] < 0.0, [0.0, -3.0, 0.0], 0.0)
    warp = Warp.through("mr", origin, knot_mm, pull, np.where(places[:, 2] < 0.0, 0.1, 4.0))
    shown = shape_shown("the front <lies> 3 mm further out", mesh, warp, 1.0)
    outward = shown.outward_mm.reshape(2, 2, 2)
    np.testing.assert_allclose(outward[:, 0], 3.0, atol=0.3)
    np.testing.assert_allclose(outward[:, 1], 0.0, atol=0.3)
    assert shown.known.reshape(2, 2, 2)[:, :, 0].all()
    assert not shown.known.reshape(2, 2, 2)[:, :, 1].any()
    html = registration_html(replace(page(), shape=shown))
    assert "The front &lt;lies&gt; 3 mm further out." in html
    assert html.count("<img") == registration_html(page()).count("<img") + 1


def test_it_says_whether_the_pose_may_be_used() -> None:
    good, bad = (registration_html(replace(page(), usable=usable)) for usable in (True, False))
    assert "class='verdict good'" in good
    assert "✓ This registration may be used" in good
    assert "REFUSED" not in good
    assert good.index("<span>largest error over the heart: below 3.1 mm, at 95 %</span>") < good.index("<h2>")
    assert "class='verdict bad'" in bad
    assert "✕ REFUSED: this registration must not be used" in bad
    assert "may be used" not in bad
    assert bad.count("<figcaption class=refused>registered, refused:") == 4
    assert "refused" in str(outline_of(bad).images[1]["alt"])


def test_every_check_stands_with_its_outcome() -> None:
    text = registration_html(page())
    assert "<td>98 %</td><td>at least 35 %</td><td class=passed>✓ passed</td>" in text
    assert "<td>7.00 mm</td><td>at most 4 mm</td><td class=failed>✕ failed</td>" in text
    assert "<td>0.70 mm</td><td></td><td class=other>no limit, for information</td>" in text
    assert "<td></td><td></td><td class=other>– not checked</td>" in text


def test_planes_say_which_and_when() -> None:
    text = registration_html(page())
    assert "<h3>frame 3, axial, tilted by 12°, 2.5 s, 40 % of the cycle</h3>" in text
    assert "<h3>frame 9, axial, tilted by 12°, 40 % of the cycle</h3>" in text


def test_the_key_names_what_is_drawn() -> None:
    text = registration_html(page())
    assert "the model&#x27;s surface" in text
    assert "blood" in text
    bare = AnatomyPlane(np.zeros((80, 60)), None, None, ("R", "L", "A", "P"))
    lone = overlay(start=bare, registered=bare, outline_levels=(0.5,))
    text = registration_html(replace(page(), planes=[lone], anatomy="moving image"))
    assert "the model&#x27;s" not in text
    assert "blood" not in text
    assert "outlines in the moving image" in text


def test_contours_lie_where_the_distance_is_zero() -> None:
    given = overlay()
    for anatomy, surface_mm in ((given.start, 10.0), (given.registered, 20.0)):
        _, blood, surface = fused_figure(given, anatomy).axes[0].collections
        for contour, y_mm in ((surface, surface_mm), (blood, surface_mm + 5.0)):
            drawn = np.concatenate([path.vertices for path in contour.get_paths()])
            assert drawn[:, 1] == pytest.approx(y_mm)
            assert (drawn[:, 0].min(), drawn[:, 0].max()) == (0.5, 59.5)


def test_outlines_stand_in_for_a_model() -> None:
    bare = replace(overlay().start, distance_mm=None, blood_mm=None)
    assert len(fused_figure(overlay(), bare).axes[0].collections) == 0
    (outline,) = fused_figure(overlay(outline_levels=(0.5,)), bare).axes[0].collections
    drawn = np.concatenate([path.vertices for path in outline.get_paths()])
    assert drawn[:, 1] == pytest.approx(10.0)


def test_colour_comes_from_the_anatomy_alone() -> None:
    given = overlay()
    rgb = fused_rgb(given.image, given.registered.grey)
    np.testing.assert_allclose(rgb[:40], 0.2)
    red, green, blue = rgb[60, 30]
    assert red > green > blue
    np.testing.assert_allclose(fused_rgb(given.image, np.full((80, 60), np.nan)), 0.2)
    bright = fused_rgb(np.full((80, 60), 255, np.uint8), given.registered.grey)
    assert bright[60, 30, 2] < bright[60, 30, 1] < bright[60, 30, 0]


def test_checkerboards_alternate_in_mm() -> None:
    squares = checkerboard((80, 60), (1.0, 0.5), 10.0)
    assert not squares[0, 0]
    assert squares[0, 10]
    assert squares[20, 0]
    assert not squares[20, 10]
    rgb = np.asarray(checkerboard_figure(overlay(), overlay().registered).axes[0].images[0].get_array())
    edge = 60.0 / 8
    squares = checkerboard((80, 60), (1.0, 0.5), edge)
    np.testing.assert_allclose(rgb[~squares], 0.2)
    np.testing.assert_allclose(rgb[squares & (overlay().registered.grey == 0)], 0.0)


def test_panels_are_to_scale_with_a_scale_bar_and_the_patients_sides() -> None:
    figure = fused_figure(overlay(), overlay().start)
    axis = figure.axes[0]
    width, height = figure.get_size_inches()
    assert width / height == pytest.approx(60.0 / 40.0)
    _, bar = axis.lines
    x = np.asarray(bar.get_xdata())
    assert x[1] - x[0] == pytest.approx(20.0)
    assert [text.get_text() for text in axis.texts] == ["20 mm", "R", "L", "A", "P"]
    assert [scale_bar_mm(mm) for mm in (2.0, 40.0, 170.0)] == [1.0, 10.0, 50.0]


def test_slicer_shows_the_inverse_in_ras() -> None:
    transform = page().transform
    lps_tracker = np.array([3.0, 4.0, 5.0, 1.0])
    flip = np.diag([-1.0, -1.0, 1.0, 1.0])
    ras_mr = flip @ TURN @ lps_tracker
    np.testing.assert_allclose(transform.slicer_matrix @ ras_mr, flip @ lps_tracker)
    text = registration_html(page())
    assert "mr_from_tracker maps points of the tracker to the MR" in text
    assert "<td>0.0000</td><td>-1.0000</td><td>0.0000</td><td>5.0000</td>" in text
    assert "<td>0.0000</td><td>1.0000</td><td>0.0000</td><td>-7.0000</td>" in text
