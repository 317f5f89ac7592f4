"""Sphinx extension: a path such as `dvf_ig/cardiac/retime.py` in a page links to that module's API page.

A path that names no file of the repository is a warning, and warnings are errors here.
"""

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

ROOT = Path(__file__).resolve().parents[2]
_PATH = re.compile(r"(?:dvf_ig|data_synth)(?:/\w+)*/?(?:\.py)?")
_log = logging.getLogger(__name__)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the handler, which runs once all pages are known."""
    app.connect("doctree-resolved", _link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _link(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    if docname.startswith("api/"):
        return
    for literal in list(doctree.findall(nodes.literal)):
        text = literal.astext()
        if not _PATH.fullmatch(text) or isinstance(literal.parent, nodes.reference):
            continue
        if not (ROOT / text).exists():
            _log.warning("%s names %s, which does not exist", docname, text)
            continue
        page = f"api/{text.removesuffix('.py').rstrip('/')}/index"
        if page in app.env.found_docs:
            uri = app.builder.get_relative_uri(docname, page)
            link = nodes.reference("", "", literal.deepcopy(), refuri=uri, internal=True)
            literal.replace_self(link)
