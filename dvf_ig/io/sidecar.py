"""Files that are written beside the one a user named: they never take the place of a file of the user's own.

What this program writes carries a mark: the field `written_by` in JSON, with the kind of its content, a
comment in XML, HTML and the header of a sequence, the software entry of a PNG. A file without it is somebody
else's.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dvf_ig.core.errors import OutputError
from dvf_ig.io.json_file import plain, write_json
from dvf_ig.io.provenance import provenance_fields

MARK = "dvf_ig"
MARKUP_COMMENT = f" written by {MARK} "
SEQUENCE_COMMENT = f"written by {MARK}"
_PNG_SOFTWARE = f"Software\0{MARK}".encode()


def write_sidecar(path: Path, content: Mapping[str, Any], kind: str, named: Path | None = None) -> None:
    """Write a result as JSON: with our mark and its kind, and where it comes from (see `provenance_fields`).

    Args:
        path: the file.
        content: the object.
        kind: what it holds, for example "transform"; a file of another kind is not replaced either.
        named: the file that the user named, which may be replaced whatever it holds.
    Raises:
        OutputError: a file of the user's own, or of another kind, is there; or not writable.
    """
    refuse_foreign(path, kind=kind, named=named)
    write_json(path, {**plain({**content, **provenance_fields()}), "kind": kind, "written_by": MARK})


def refuse_foreign(*paths: Path, kind: str | None = None, named: Path | None = None) -> None:
    """Refuse paths at which a file stands that this program did not write.

    Args:
        paths: JSON, XML, HTML or PNG files, sequences, or ITK transforms `.tfm`, `.h5`, whose mark is in
            the JSON beside them.
        kind: of JSON; None accepts every kind.
        named: see `write_sidecar`.
    Raises:
        OutputError: naming the file.
    """
    for path in paths:
        if path != named and path.is_file() and not _is_ours(path, kind):
            raise OutputError(
                f"cannot write {path}: a file of that name exists and was not written by this command; "
                "move it, or choose another name for the output"
            )


def _is_ours(path: Path, kind: str | None) -> bool:
    try:
        if path.suffix.lower() in (".h5", ".tfm"):
            return _json_kind(path.with_suffix(".json")) == "transform"
        if path.suffix.lower() == ".json":
            found = _json_kind(path)
            return found is not None and kind in (None, found)
        content = path.read_bytes()
    except OSError:
        return False
    marks = (f"<!--{MARKUP_COMMENT}-->".encode(), _PNG_SOFTWARE, f"Comment = {SEQUENCE_COMMENT}".encode())
    return any(mark in content[:4096] for mark in marks)


def _json_kind(path: Path) -> str | None:
    """Kind of a JSON file of ours; None of another."""
    try:
        document = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(document, dict) or document.get("written_by") != MARK:
        return None
    return str(document.get("kind"))
