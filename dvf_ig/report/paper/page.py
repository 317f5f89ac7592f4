"""The page of the paper's figures and Table II, and the figures as files."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.io.writing.atomic import write_bytes
from dvf_ig.report.page import html_page, png_tag, section, table
from dvf_ig.report.style import png_bytes, svg_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "Dynamic virtual fixtures: the figures of Ren 2008 from this model"
ABOUT = (
    "Ren, Patel, McIsaac, Guiraudon, Peters: Dynamic 3-D Virtual Fixtures for Minimally Invasive Beating "
    "Heart Procedures. IEEE Transactions on Medical Imaging 27(8), 2008. The figures here show what the "
    "paper's figures are about, under their numbers, on a synthetic four-chamber heart whose surface moves "
    "by up to 5 mm (motion preset paper5mm); they are not copies, and the heart is another one."
)
PIXELS_PER_INCH = 88
"""Width of a figure on the page."""


@dataclass(frozen=True, slots=True, eq=False)
class PaperFigure:
    """A figure with its place in the paper.

    Attributes:
        name: of its files.
        source: which figure or equation of the paper it stands for.
        caption: what it shows.
        figure: drawn.
    """

    name: str
    source: str
    caption: str
    figure: Figure


def write_paper_figures(folder: Path, figures: Sequence[PaperFigure]) -> list[Path]:
    """Write each figure as PNG and SVG; the files written.

    Raises:
        OutputError: not writable.
    """
    written = []
    for each in figures:
        for suffix, data in ((".png", png_bytes(each.figure, dpi=130)), (".svg", svg_bytes(each.figure))):
            written.append(folder / f"{each.name}{suffix}")
            write_bytes(written[-1], data)
    return written


def paper_html(figures: Sequence[PaperFigure], rows: Sequence[tuple[str, str, str]]) -> str:
    """The page, to lie beside the files of `write_paper_figures`.

    Args:
        figures: in the order of the paper.
        rows: Table II: quantity, here, in the paper.
    """
    body = f"<p class=note>{html.escape(ABOUT)}</p>" + "".join(map(_part, figures))
    found = table(("", "here", "Ren 2008"), rows)
    note = "Times are of this machine, which may be busy with something else."
    return html_page(TITLE, body + section("After Table II: accuracy and speed", note, found))


def _part(each: PaperFigure) -> str:
    width_px = round(PIXELS_PER_INCH * each.figure.get_size_inches()[0])
    image = png_tag(png_bytes(each.figure, dpi=130), each.source, width_px=width_px)
    words = f"<b>{html.escape(each.source)}.</b> {html.escape(each.caption)}"
    return f"<figure>{image}<figcaption>{words} (<a href='{each.name}.svg'>SVG</a>)</figcaption></figure>"
