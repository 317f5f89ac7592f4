"""JSON results with where they come from, and the marks by which this program's files are known.

What this program writes carries a mark: the field `written_by` in JSON, with the kind of its content, and a
comment in XML, HTML and the header of a sequence.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dvf_ig.io.json_file import plain, write_json
from dvf_ig.io.provenance import provenance_fields

MARK = "dvf_ig"
MARKUP_COMMENT = f" written by {MARK} "
SEQUENCE_COMMENT = f"written by {MARK}"


def write_sidecar(path: Path, content: Mapping[str, Any], kind: str) -> None:
    """Write a result as JSON: with our mark and its kind, and where it comes from (see `provenance_fields`).

    Args:
        path: the file.
        content: the object.
        kind: what it holds, for example "transform".
    Raises:
        OutputError: not writable.
    """
    write_json(path, {**plain({**content, **provenance_fields()}), "kind": kind, "written_by": MARK})
