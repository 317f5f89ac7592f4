"""Build the viewer's page with its data, for writing to a file."""

import html
import json
from collections.abc import Mapping
from importlib import resources
from typing import Any

from dvf_ig.core.errors import InvalidInputError

SLOT = '<script type="application/json" id="dvf-scene"></script>'
"""Element with the page's data; if empty, the page requests `scene.json` and `events` from its server."""
_TITLE = "<title>dvf-ig viewer</title>"


def live_page() -> str:
    """Return the page without data, for a server."""
    return resources.files("dvf_ig.report").joinpath("web/built/viewer.html").read_text(encoding="utf-8")


def viewer_html(payload: Mapping[str, Any]) -> str:
    """Build the self-contained page with a scene and its series.

    Raises:
        InvalidInputError: a number that is not finite.
    """
    template = live_page()
    try:
        text = json.dumps(payload, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    except ValueError as exc:
        raise InvalidInputError(f"the scene holds a number that is not finite ({exc})") from exc
    for what in (SLOT, _TITLE):
        if template.count(what) != 1:
            raise InvalidInputError(f"the viewer's template lacks {what}; build it again (scripts/viewer)")
    safe = text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
    title = f"<title>{html.escape(str(payload['title']))}</title>"
    head, tail = template.split(SLOT)
    return head.replace(_TITLE, title) + SLOT.replace("></", f">{safe}</") + tail.replace(_TITLE, title)
