"""Write JSON results with their provenance, and a mark that names the program that made a file.

The mark is the field `written_by` in JSON, with the kind of content, and a comment in XML, HTML and the
header of a sequence. What a command may replace is decided by the folder's listing (`io/writing/listing`).
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
    """Write a result as JSON with our mark, its kind and its provenance (see `provenance_fields`).

    Args:
        path: the file.
        content: the object.
        kind: of the content, for example "transform".
    Raises:
        OutputError: not writable.
    """
    write_json(path, {**plain({**content, **provenance_fields()}), "kind": kind, "written_by": MARK})
