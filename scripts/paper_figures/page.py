"""Build the page of the paper's figures and tables, and write the figures as files."""

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

TITLE = "Dynamic virtual fixtures: the tables and figures of Ren 2008 from this model"
ABOUT = (
    "Ren, Patel, McIsaac, Guiraudon, Peters: Dynamic 3-D Virtual Fixtures for Minimally Invasive Beating "
    "Heart Procedures. IEEE Transactions on Medical Imaging 27(8), 2008. The figures show the same "
    "quantities as the paper's figures of the same number, on a synthetic four-chamber heart whose surface "
    "moves by up to 5 mm (motion preset paper5mm); they are not copies, and the heart differs."
)
PIXELS_PER_INCH = 88
"""Width of a figure on the page, pixels per inch."""


@dataclass(frozen=True, slots=True, eq=False)
class PaperFigure:
    """A figure and its counterpart in the paper.

    Attributes:
        name: of its files.
        source: corresponding figure or equation of the paper.
        caption: what it shows.
        figure: the drawing.
    """

    name: str
    source: str
    caption: str
    figure: Figure


@dataclass(frozen=True, slots=True)
class PaperTable:
    """A table of the paper's rows and of those from here.

    Attributes:
        title: of the section.
        rows: the first is the heading.
        meanings: sentences: what each difference means, and the paper's errata.
    """

    title: str
    rows: Sequence[Sequence[str]]
    meanings: Sequence[str]


def write_paper_figures(folder: Path, figures: Sequence[PaperFigure]) -> list[Path]:
    """Write each figure as PNG and SVG, and return the files.

    Raises:
        OutputError: not writable.
    """
    written = []
    for each in figures:
        for suffix, data in ((".png", png_bytes(each.figure, dpi=130)), (".svg", svg_bytes(each.figure))):
            written.append(folder / f"{each.name}{suffix}")
            write_bytes(written[-1], data)
    return written


def paper_html(figures: Sequence[PaperFigure], tables: Sequence[PaperTable]) -> str:
    """Build the page; it belongs in the folder of the files of `write_paper_figures`.

    Args:
        figures, tables: in the order of the paper.
    """
    head = f"<p class=note>{html.escape(ABOUT)}</p>"
    body = "".join(map(_table, tables)) + "<h2>Figures</h2>" + "".join(map(_part, figures))
    return html_page(TITLE, head + body)


def _table(each: PaperTable) -> str:
    meanings = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in each.meanings)
    return section(each.title, "", table(each.rows[0], each.rows[1:]) + f"<ul>{meanings}</ul>")


def _part(each: PaperFigure) -> str:
    width_px = round(PIXELS_PER_INCH * each.figure.get_size_inches()[0])
    image = png_tag(png_bytes(each.figure, dpi=130), each.source, width_px=width_px)
    words = f"<b>{html.escape(each.source)}.</b> {html.escape(each.caption)}"
    return f"<figure>{image}<figcaption>{words} (<a href='{each.name}.svg'>SVG</a>)</figcaption></figure>"
