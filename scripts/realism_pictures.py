"""Draw the realism of the synthetic ultrasound, and build a page with every measured figure.

matplotlib is loaded when the pictures are drawn.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rayleigh

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.report.page import html_page, png_tag, section, table
from dvf_ig.report.style import ESTIMATE, FAINT, TRUTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Views = Sequence[Mapping[str, NDArray[np.uint8]]]
"""Rows of images by title."""

_PAGE_STYLE = "body { max-width: 1400px; } tr.no td { background: #fdd; } "
_PAGE_STYLE += "td:nth-child(2), td:nth-child(3) { text-align: right; } img { width: 100%; }"


class BoundedFigure(Protocol):
    """A measured figure and the interval that it has to lie in."""

    @property
    def name(self) -> str: ...
    @property
    def value(self) -> float: ...
    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...
    @property
    def passed(self) -> bool: ...


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RealismPictures:
    """Data of the pictures.

    Attributes:
        envelopes: of homogeneous myocardium, linear, any shape.
        depths_mm: (samples,) depth of the receive samples.
        imaging_depth_mm: depth at which the image ends.
        points_db: (lines, samples) image of point targets, relative to their peaks.
        contrasts_db: echo relative to myocardium by tissue: (in the table, measured).
        attenuation_db: power over depth by tissue: ((samples,) simulated, (samples,) expected).
        hearts: standard views by motion: end-diastole, then end-systole.
    """

    envelopes: FloatArray
    depths_mm: FloatArray
    imaging_depth_mm: float
    points_db: FloatArray
    contrasts_db: Mapping[str, tuple[float, float]]
    attenuation_db: Mapping[str, tuple[FloatArray, FloatArray]]
    hearts: Mapping[str, Views]


def realism_figure(shown: RealismPictures) -> Figure:
    """Draw statistics above, and each heart in the standard views at end-diastole and end-systole below."""
    from matplotlib.figure import Figure

    count = len(shown.hearts)
    figure = Figure(figsize=(14.0, 4.0 + 6.4 * count), layout="constrained")
    parts = figure.subfigures(1 + count, 1, squeeze=False, height_ratios=[4.0, *[6.4] * count])
    upper = parts[0, 0].subplots(1, 4)
    _draw_histogram(upper[0], shown.envelopes)
    _draw_points(upper[1], shown.points_db, shown.imaging_depth_mm)
    _draw_contrast(upper[2], shown.contrasts_db)
    _draw_attenuation(upper[3], shown.depths_mm, shown.attenuation_db)
    for part, (motion, views) in zip(parts[1:, 0], shown.hearts.items(), strict=True):
        part.suptitle(f"{motion}: end-diastole above, end-systole below")
        axes = part.subplots(len(views), len(views[0]))
        for row, images in zip(axes, views, strict=True):
            for axis, (title, image) in zip(row, images.items(), strict=True):
                axis.imshow(image, cmap="gray", vmin=0, vmax=255)
                axis.set_title(title, fontsize=8)
                axis.axis("off")
    return figure


def realism_html(
    figures: Iterable[BoundedFigure], picture_png: bytes, title: str, compared: Sequence[Sequence[str]] = ()
) -> str:
    """Build a self-contained page.

    Args:
        compared: rows of a table beside real recordings, its heading first; empty leaves it out.
    """
    rows = "".join(
        f"<tr class='{'ok' if f.passed else 'no'}'><td>{html.escape(f.name)}</td><td>{f.value:.4g}</td>"
        f"<td>{bounds_text(f)}</td><td>{'pass' if f.passed else 'FAIL'}</td></tr>"
        for f in figures
    )
    head = "<tr><th>measured figure</th><th>value</th><th>bounds</th><th></th></tr>"
    body = f"{png_tag(picture_png, 'pictures')}<table>{head}{rows}</table>"
    if compared:
        note = (
            "Smallest to largest of the synthetic recordings. The real ones are of other organs and scanners."
        )
        body += section("Grey levels beside real recordings", note, table(compared[0], compared[1:]))
    return html_page(title, body, style=_PAGE_STYLE)


def bounds_text(figure: BoundedFigure) -> str:
    """Format the interval as text."""
    if np.isinf(figure.high):
        return f"≥ {figure.low:.4g}"
    return f"{figure.low:.4g} … {figure.high:.4g}"


def _draw_histogram(axis: Axes, envelopes: FloatArray) -> None:
    scale = float(np.sqrt((envelopes**2).mean() / 2))
    levels = np.linspace(0, 4.5 * scale, 200)
    axis.hist(envelopes.ravel(), bins=80, range=(0, 4.5 * scale), density=True, color=ESTIMATE, alpha=0.5)
    axis.plot(levels, rayleigh.pdf(levels, scale=scale), color=TRUTH, lw=1, label="Rayleigh")
    axis.set_title("speckle in myocardium", fontsize=10)
    axis.set_xlabel("envelope, re myocardium")
    axis.legend(loc="upper right", fontsize=8)


def _draw_points(axis: Axes, points_db: FloatArray, depth_mm: float) -> None:
    half = 0.5 * len(points_db)
    extent = (0.0, depth_mm, -half, half)
    axis.imshow(points_db, aspect="auto", extent=extent, cmap="gray", interpolation="nearest")
    axis.set_title("points at 40, 80, 120 mm (40 dB)", fontsize=9)
    axis.set_xlabel("depth, mm")
    axis.set_ylabel("scan line from the middle")


def _draw_contrast(axis: Axes, contrasts_db: Mapping[str, tuple[float, float]]) -> None:
    place = np.arange(len(contrasts_db))
    table, measured = zip(*contrasts_db.values(), strict=True)
    axis.bar(place - 0.2, table, 0.4, label="table", color=FAINT)
    axis.bar(place + 0.2, measured, 0.4, label="measured", color=ESTIMATE)
    axis.set_xticks(place, list(contrasts_db), rotation=20, fontsize=8)
    axis.set_title("echo re myocardium, dB", fontsize=9)
    axis.legend(fontsize=8)


def _draw_attenuation(
    axis: Axes, depths_mm: FloatArray, attenuation_db: Mapping[str, tuple[FloatArray, FloatArray]]
) -> None:
    for tissue, (simulated, expected) in attenuation_db.items():
        axis.plot(depths_mm, simulated, lw=0.7, label=tissue)
        axis.plot(depths_mm, expected, "--", color=TRUTH, lw=1)
    axis.set_title("power with depth, dB; dashed 2 alpha f", fontsize=9)
    axis.set_xlabel("depth, mm")
    axis.legend(fontsize=8)
