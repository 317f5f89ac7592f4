"""Sphinx extension: formulas as SVG drawn at build time; the browser needs no script, font or network."""

from functools import cache
from html import escape
from typing import Any

import ziamath
from docutils import nodes
from sphinx.application import Sphinx

SIZE_PX = 17.0

# outlines instead of shared symbols: many formulas on a page may not use one another's glyphs
ziamath.config.svg2 = False
ziamath.config.math.color = "currentColor"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer under the name "svg"."""
    app.add_html_math_renderer("svg", (_inline, None), (_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(writer: Any, node: nodes.Element) -> None:
    # a word joiner keeps the comma behind a formula on its line
    writer.body.append(_drawn(node.astext(), inline=True) + "\u2060")
    raise nodes.SkipNode


def _display(writer: Any, node: nodes.Element) -> None:
    writer.body.append(f'<div class="formula">{_drawn(node.astext(), inline=False)}</div>')
    raise nodes.SkipNode


@cache
def _drawn(latex: str, inline: bool) -> str:
    """Draw one formula, with its LaTeX as the text for screen readers."""
    drawn = ziamath.Latex(" ".join(latex.split()), size=SIZE_PX, inline=inline)
    svg = drawn.svg().removeprefix("<svg ")
    style = f"vertical-align:{drawn.getyofst():.2f}px"
    return f'<svg role="img" aria-label="{escape(latex)}" style="{style}" {svg}'
