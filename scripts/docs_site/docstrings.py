"""Sphinx extension: docstrings are plain text with `code` and sections ("Args:"); turn them into safe markup.

No character of a docstring is taken for markup except backquotes: formulas with *, | or _ stay as written.
"""

import re
from typing import Any

from sphinx.application import Sphinx

SECTIONS = ("Args", "Attributes", "Returns", "Raises", "Yields", "Fields")
_SECTION = re.compile(rf"({'|'.join(SECTIONS)}):\s*$")
_NAMED = re.compile(r"(?P<names>[*\w][\w*, .]*):\s+(?P<text>.*)")
_ITEM = re.compile(r"(?:[-*]|\d+\.)\s+")


def setup(app: Sphinx) -> dict[str, Any]:
    """Hook into the docstrings that autoapi reads."""
    app.connect("autodoc-process-docstring", _process)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _process(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = marked_up(lines)


def marked_up(lines: list[str]) -> list[str]:
    """Convert a docstring's lines to reStructuredText."""
    out: list[str] = []
    rest = [line.rstrip() for line in lines]
    while rest:
        if not rest[0]:
            rest.pop(0)
        elif heading := _SECTION.match(rest[0]):
            out += _section(heading.group(1), _block(rest[1:], rest))
        elif rest[0].startswith(" "):
            out += ["::", "", *(f"    {line}" for line in _block(rest, rest)), ""]
        else:
            out += _paragraph(rest)
    return out


def _block(lines: list[str], rest: list[str]) -> list[str]:
    """Remove the indented lines at the front; without indentation, all up to the next blank line."""
    indented = bool(lines) and lines[0].startswith(" ")
    block: list[str] = []
    for line in lines:
        if (indented and line and not line.startswith(" ")) or (not indented and not line):
            break
        if not indented and block and _SECTION.match(line):
            break
        block.append(line)
    del rest[: len(block) + (0 if lines is rest else 1)]
    while block and not block[-1]:
        block.pop()
    return block


def _section(title: str, block: list[str]) -> list[str]:
    """Format a heading and one item a name; lines deeper than the first belong to the item above."""
    depth = min((len(line) - len(line.lstrip()) for line in block if line), default=0)
    out, open_item = [f"**{title}**", ""], False
    for line in block:
        text = line.strip()
        named = _NAMED.fullmatch(text) if len(line) - len(line.lstrip()) == depth else None
        if named:
            out += ["", f"- ``{named['names']}``: {_escaped(named['text'])}"]
            open_item = True
        elif text:
            out.append(("  " if open_item else "") + _escaped(text))
    return [*out, ""]


def _paragraph(rest: list[str]) -> list[str]:
    """Remove lines up to a blank one, a section or an indented block; list items keep indented lines."""
    out: list[str] = []
    item = False
    while rest and rest[0] and not _SECTION.match(rest[0]):
        line = rest[0]
        begins = _ITEM.match(line)
        if line.startswith(" ") and not item:
            break
        if begins:
            out += [] if item else [""]
            item = True
            out.append(begins.group() + _escaped(line[begins.end() :]))
        elif line.startswith(" "):
            numbered = any(re.match(r"\d", each) for each in out[:2])
            out.append(("   " if numbered else "  ") + _escaped(line.strip()))
        else:
            out += [""] if item else []
            item = False
            out.append(_escaped(line))
        rest.pop(0)
    return [*out, ""]


def _escaped(text: str) -> str:
    """Escape text except `code`."""
    parts = re.split(r"``?([^`]+)``?", text)
    plain = (re.sub(r"([\\*|_`])", r"\\\1", part) for part in parts[::2])
    code = (f"``{part.strip()}``" for part in parts[1::2])
    # a word that touches code needs an invisible break in between
    return "".join(f"{a}\\ {b}\\ " for a, b in zip(plain, [*code, ""], strict=True)).removesuffix("\\ \\ ")
