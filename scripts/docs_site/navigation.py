"""Sphinx extension: the sidebar opens only the branch of the page.

The theme requests the whole tree on every page: a thousand modules on each of a thousand pages.
"""

from collections.abc import Callable
from typing import Any

from sphinx.application import Sphinx

BEFORE_THE_THEME = 400
"""Priority of the handler; the theme's has the default, 500."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the handler that changes the theme's context of every page."""
    app.connect("html-page-context", _open_one_branch, priority=BEFORE_THE_THEME)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _open_one_branch(
    app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: object
) -> None:
    whole: Callable[..., str] | None = context.get("toctree")
    if whole is None:  # pages outside the tree, such as the search
        return
    context["toctree"] = lambda **options: whole(**(options | {"collapse": True}))
