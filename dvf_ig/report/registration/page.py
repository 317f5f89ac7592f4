"""Build `report.html` of a registration: verdict, fused planes, evidence, and the transform."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dvf_ig.core.arrays import BoolArray, FloatArray
from dvf_ig.report.page import html_page, jpeg_tag, section, table
from dvf_ig.report.plane_marks import LETTERS_NOTE, draw_plane_marks
from dvf_ig.report.plane_overlay import AnatomyPlane, PlaneOverlay, draw_contour, image_extent
from dvf_ig.report.style import MR_ON_GREY, ON_GREY, jpeg_bytes

from .shape import ShapeShown, shape_figure
from .values import Check, Outcome, RegistrationPage, Transform

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANEL_IN = 3.9
"""Longer edge of a panel, inches."""
SQUARES = 8
"""Squares of a checkerboard along the longer edge."""
TINT, STAIN = 0.55, 0.6
"""Colour that a bright pre-operative voxel adds to dark ultrasound, and removes from bright ultrasound."""


def fused_figure(overlay: PlaneOverlay, anatomy: AnatomyPlane, *, tinted: bool = True) -> Figure:
    """Draw ultrasound in grey with the model's contours; if `tinted`, with the anatomy in colour."""
    rgb = fused_rgb(overlay.image, anatomy.grey) if tinted else _grey(overlay.image)
    figure = _panel(rgb, overlay, anatomy)
    axis = figure.axes[0]
    draw_contour(axis, anatomy.blood_mm, overlay.size_mm, "white", width=1.0, dashed=True, casing=True)
    draw_contour(axis, anatomy.distance_mm, overlay.size_mm, ON_GREY, width=1.7)
    for level in overlay.outline_levels:
        draw_contour(axis, anatomy.grey, overlay.size_mm, ON_GREY, level=level)
    return figure


def checkerboard_figure(overlay: PlaneOverlay, anatomy: AnatomyPlane) -> Figure:
    """Draw alternating squares of ultrasound in grey and anatomy in colour."""
    squares = checkerboard(overlay.image.shape, overlay.pixel_mm, max(overlay.size_mm) / SQUARES)
    coloured = np.nan_to_num(anatomy.grey)[..., None] * np.array(to_rgb(MR_ON_GREY))
    rgb = np.where(squares[..., None], coloured, _grey(overlay.image))
    return _panel(rgb, overlay, anatomy)


def fused_rgb(image: NDArray[np.uint8], grey: FloatArray) -> FloatArray:
    """Colour (rows, columns, 3) grey ultrasound by the anatomy's grey levels."""
    ultrasound, level = _grey(image), np.nan_to_num(grey)[..., None]
    color = np.array(to_rgb(MR_ON_GREY))
    stained = ultrasound * (1.0 - STAIN * level * (1.0 - color))
    return np.asarray(np.clip(stained + TINT * (1.0 - ultrasound) * level * color, 0.0, 1.0))


def checkerboard(shape: tuple[int, ...], pixel_mm: tuple[float, float], edge_mm: float) -> BoolArray:
    """Return (rows, columns) True in every second square."""
    row, column = np.indices(shape)
    return np.asarray((row * pixel_mm[1] // edge_mm + column * pixel_mm[0] // edge_mm) % 2 == 1)


def _grey(image: NDArray[np.uint8]) -> FloatArray:
    return np.repeat(np.asarray(image, dtype=np.float64)[..., None] / 255.0, 3, axis=2)


def _panel(rgb: FloatArray, overlay: PlaneOverlay, anatomy: AnatomyPlane) -> Figure:
    """Draw the image to scale, with a scale bar and the sides of the patient at its edges."""
    width_mm, height_mm = overlay.size_mm
    inch_per_mm = PANEL_IN / max(width_mm, height_mm)
    figure = Figure(figsize=(width_mm * inch_per_mm, height_mm * inch_per_mm), facecolor="black")
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.imshow(rgb, extent=image_extent(overlay.size_mm), interpolation="antialiased", aspect="auto")
    axis.set_axis_off()
    draw_plane_marks(axis, overlay.size_mm, anatomy.edges)
    return figure


STYLE = """
body { max-width: 1360px; }
.verdict { font-size: 1.05rem; display: block; padding: .6rem 1rem; print-color-adjust: exact; }
.verdict b { font-size: 1.3rem; display: block; } .verdict span { display: block; }
.mix { display: flex; gap: .8rem; align-items: center; max-width: 32rem; margin: .4rem 0 .8rem; }
.mix input { flex: 1; accent-color: #0072b2; } @media print { .mix { display: none; } }
.fade { position: relative; } .fade img + img { position: absolute; inset: 0; opacity: var(--mix, 1); }
.planes { display: grid; grid-template-columns: repeat(4, 1fr); gap: .4rem; }
@media (max-width: 900px) { .planes { grid-template-columns: repeat(2, 1fr); } }
.planes figure { margin: 0; } .planes img { width: 100%; display: block; }
.planes figcaption { font-size: .85rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem; }
.key i { display: inline-block; width: 1.6em; height: .8em; margin: 0 .35em 0 1.2em; }
.key i:first-child { margin-left: 0; }
.refused { color: #b3261e; font-weight: 600; }
td:first-child, td.passed, td.failed { white-space: nowrap; }
td.failed { color: #b3261e; font-weight: 600; } td.passed { color: #2b7a3d; } td.other { color: #555; }
table.matrix td { font-variant-numeric: tabular-nums; text-align: right; border: 0; color: inherit; }
.pair { display: flex; flex-wrap: wrap; gap: 3rem; }
@media print { .planes, tr { break-inside: avoid; } }
"""
PLANES_NOTE = (
    "If ultrasound and anatomy agree, coloured regions end at the borders of grey ones, and lines continue "
    f"from square to square of the checkerboards. {LETTERS_NOTE} by the pose of that picture."
)
OUTCOME_CLASS = {Outcome.PASSED: "passed", Outcome.FAILED: "failed"}


def registration_html(page: RegistrationPage) -> str:
    """Build the page for one registration."""
    view = f'<p><a href="{html.escape(page.view)}">Interactive 3-D view of the planes</a></p>'
    body = (
        f"<p class=note>{html.escape(page.about)}</p>{_verdict(page)}{view if page.view else ''}"
        + section(
            "Ultrasound and anatomy, before and after registration",
            f"{PLANES_NOTE} {page.remark}".strip(),
            _planes(page),
        )
        + _shape(page.shape)
        + section(
            "Evidence",
            "Checks of the pose. One failed check is enough to refuse it; passed checks are no proof.",
            _checks(page.checks),
        )
        + section("Result", "", table(("", "value", "what it means"), page.findings))
        + section("Transform", _transform_note(page.transform), _matrices(page.transform))
        + section("What was registered", "", table(("", ""), page.data))
        + section("How it was computed", "", table(("", ""), page.made))
    )
    return html_page(page.title, body, style=STYLE)


def _shape(shape: ShapeShown | None) -> str:
    """Build the section on a heart that has changed its shape."""
    if shape is None:
        return ""
    said = f"{shape.sentence[0].upper()}{shape.sentence[1:]}."
    picture = jpeg_tag(jpeg_bytes(shape_figure(shape)), "the heart's surface in the MR and now")
    return section("The heart has changed its shape", said, picture)


def _verdict(page: RegistrationPage) -> str:
    kind, head = (
        ("good", "✓ This registration may be used")
        if page.usable
        else ("bad", "✕ REFUSED: this registration must not be used")
    )
    lines = (f"{name}: {value}" for name, value in reversed(page.stated))
    stated = "".join(f"<span>{html.escape(line)}</span>" for line in lines)
    return f"<p class='verdict {kind}' role=status><b>{head}</b>{stated} {html.escape(page.reason)}</p>"


def _planes(page: RegistrationPage) -> str:
    slider = (
        "<label class=mix>ultrasound <input type=range min=0 max=1 step=0.01 value=1 "
        "oninput=\"document.body.style.setProperty('--mix', value)\"> "
        f"with {html.escape(page.anatomy)} (registered pose)</label>"
    )
    return _key(page) + (slider if page.planes else "") + "".join(_plane(one, page) for one in page.planes)


def _key(page: RegistrationPage) -> str:
    entries = [(f"background:{MR_ON_GREY}", f"{page.anatomy}, over ultrasound in grey")]
    if any(overlay.registered.distance_mm is not None for overlay in page.planes):
        entries.append((f"border-bottom:3px solid {ON_GREY}", "the model's surface"))
    if any(overlay.registered.blood_mm is not None for overlay in page.planes):
        entries.append(("border-bottom:2px dashed #777", "border of the model's blood (white in the images)"))
    if any(overlay.outline_levels for overlay in page.planes):
        entries.append((f"border-bottom:3px solid {ON_GREY}", f"outlines in the {page.anatomy}"))
    return (
        "<p class=key>"
        + "".join(f'<i style="{look}"></i>{html.escape(text)}' for look, text in entries)
        + "</p>"
    )


def _plane(overlay: PlaneOverlay, page: RegistrationPage) -> str:
    refused = "" if page.usable else ", refused"
    poses = (("start pose", overlay.start, ""), (f"registered{refused}", overlay.registered, refused))
    contours = " and the model's contours" if overlay.registered.distance_mm is not None else ""
    contours = " and its outlines" if overlay.outline_levels else contours
    fused = f"{page.anatomy}{contours} over ultrasound"
    board = f"checkerboard of ultrasound and {page.anatomy}"
    figures = []
    for pose, anatomy, mark in poses:
        layers = {fused: fused_figure(overlay, anatomy)}
        if anatomy is overlay.registered:
            layers = {f"ultrasound{contours}": fused_figure(overlay, anatomy, tinted=False), **layers}
        figures.append(_figure(layers, pose, overlay, mark))
    figures += [
        _figure({board: checkerboard_figure(overlay, anatomy)}, pose, overlay, mark)
        for pose, anatomy, mark in poses
    ]
    heading = ", ".join(part for part in (overlay.name, overlay.plane, overlay.moment) if part)
    return f"<h3>{html.escape(heading)}</h3><div class=planes>{''.join(figures)}</div>"


def _figure(layers: Mapping[str, Figure], pose: str, overlay: PlaneOverlay, mark: str) -> str:
    """Build a captioned picture from what it shows; of two layers the slider fades the upper one."""
    look = " class=refused" if mark else ""
    tags = "".join(
        jpeg_tag(jpeg_bytes(figure), f"{overlay.name}, {pose}: {shows}") for shows, figure in layers.items()
    )
    *_, caption = layers
    return (
        f"<figure><div class=fade>{tags}</div>"
        f"<figcaption{look}>{html.escape(pose)}: {html.escape(caption)}</figcaption></figure>"
    )


def _checks(checks: Sequence[Check]) -> str:
    head = "".join(f"<th>{name}</th>" for name in ("check", "what it measures", "value", "limit", "outcome"))
    rows = "".join(
        "<tr>"
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in (c.name, c.measures, c.value, c.limit))
        + f"<td class={OUTCOME_CLASS.get(c.outcome, 'other')}>{c.outcome.value}</td></tr>"
        for c in checks
    )
    return f"<table><tr>{head}</tr>{rows}</table>"


def _transform_note(transform: Transform) -> str:
    target = transform.target_name
    return (
        f"{transform.target}_from_{transform.source} maps points of {transform.source_name} to {target}: "
        f"mm, LPS. {transform.file} and the .h5 file hold it as an ITK transform. 3D Slicer loads "
        "either (Add Data) and shows the inverse in RAS, the right matrix below. To see "
        f"{target} at the position of the ultrasound, put it under the loaded transform; to see the "
        f"ultrasound on {target}, invert the node (Transforms module, Invert) and put the ultrasound "
        "under it."
    )


def _matrices(transform: Transform) -> str:
    return (
        "<div class=pair>"
        + _matrix(f"{transform.target}_from_{transform.source} (LPS)", transform.matrix)
        + _matrix("as 3D Slicer shows it (RAS, to parent)", transform.slicer_matrix)
        + "</div>"
    )


def _matrix(title: str, matrix: FloatArray) -> str:
    rows = "".join("<tr>" + "".join(f"<td>{v:.4f}</td>" for v in row) + "</tr>" for row in matrix + 0.0)
    return f"<div><h3>{html.escape(title)}</h3><table class=matrix>{rows}</table></div>"
