"""Short text and a table for a notebook, for results whose arrays nobody wants printed."""

import html
from collections.abc import Sequence

Rows = Sequence[tuple[str, str]]
"""Names and values, in plain text."""


def summary_text(name: str, rows: Rows) -> str:
    """Write rows as the text of `print`, for example "Replay(scenario: calm; force: 0.55 N max)"."""
    return f"{name}({'; '.join(f'{key}: {value}' for key, value in rows)})"


def summary_html(name: str, rows: Rows) -> str:
    """Write rows as the table that a notebook shows."""
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(key)}</th><td style='text-align:left'>"
        f"{html.escape(value)}</td></tr>"
        for key, value in rows
    )
    return f"<table><caption>{html.escape(name)}</caption>{cells}</table>"
