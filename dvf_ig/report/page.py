"""Build self-contained HTML pages: one skeleton and style, figures inlined, tables of text."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dvf_ig.io.provenance import MARKUP_COMMENT

from .style import png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1c; max-width: 1080px; margin: 2rem auto;
       padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .3rem; }
p.note { color: #555; margin: .2rem 0 .8rem; max-width: 75ch; }
table { border-collapse: collapse; }
th { text-align: left; font-weight: 600; padding: .25rem 1rem .25rem 0; border-bottom: 1px solid #999; }
td { padding: .25rem 1rem .25rem 0; border-bottom: 1px solid #e4e4e4; vertical-align: top; }
td:first-child { color: #555; } img { max-width: 100%; height: auto; }
figure { margin: 2rem 0; } figcaption { color: #555; max-width: 75ch; }
.verdict { display: inline-block; padding: .3rem .8rem; border-radius: .3rem; color: #fff; }
.good { background: #2b7a3d; } .warn { background: #ffb300; color: #1c1c1c; } .bad { background: #b3261e; }
@media (prefers-color-scheme: dark) {
  :root { color-scheme: dark; } body { background: #17191c; color: #e4e6e8; } a { color: #7db7ec; }
  p.note, figcaption, td:first-child { color: #a5abb2; } th { border-color: #777; } td { border-color: #333; }
  img { background: #fff; border-radius: .4rem; }
}
"""


def html_page(title: str, body: str, *, style: str = "") -> str:
    """Build a complete page.

    Args:
        title: plain text, also the first heading.
        body: HTML below it.
        style: CSS rules in addition to the common ones.
    """
    name = html.escape(title)
    return (
        f"<!doctype html><!--{MARKUP_COMMENT}--><html lang=en><meta charset=utf-8>"
        f'<meta name=viewport content="width=device-width"><title>{name}</title>'
        f"<style>{STYLE}{style}</style><h1>{name}</h1>{body}</html>\n"
    )


def section(title: str, note: str, content: str) -> str:
    """Build a heading, a grey paragraph and HTML below them; title and note are plain text."""
    return f"<h2>{html.escape(title)}</h2><p class=note>{html.escape(note)}</p>{content}"


def table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Build a table of plain text."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in heading)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{head}</tr>{body}</table>"


def image_tag(figure: Figure, title: str, *, width_px: int | None = None) -> str:
    """Embed a figure as a PNG."""
    return png_tag(png_bytes(figure), title, width_px=width_px)


def png_tag(png: bytes, title: str, *, width_px: int | None = None) -> str:
    """Embed the bytes of a PNG file."""
    return _tag(png, "png", title, width_px)


def jpeg_tag(jpeg: bytes, title: str, *, width_px: int | None = None) -> str:
    """Embed the bytes of a JPEG file."""
    return _tag(jpeg, "jpeg", title, width_px)


def _tag(image: bytes, kind: str, title: str, width_px: int | None) -> str:
    data = base64.b64encode(image).decode("ascii")
    size = "" if width_px is None else f' width="{width_px}"'
    return f'<img alt="{html.escape(title)}"{size} src="data:image/{kind};base64,{data}">'
