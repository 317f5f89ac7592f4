"""The page of constants names every constant of registration with the value that it has."""

import re
from pathlib import Path

from dvf_ig.study.constants.listing import registration_constants
from dvf_ig.study.constants.subjects import subject_of
from dvf_ig.study.constants.table import value_text

PAGE = Path(__file__).resolve().parents[2] / "dvf_ig" / "docs" / "constants.md"
PLACE = re.compile(r"^## (.+)$", re.MULTILINE)
ROW = re.compile(r"^\| `([\w.]+)` \| ([^|]+) \| .* \| ([a-z]*) \|[^|]*\|[^|]*\|$", re.MULTILINE)


def test_the_page_is_what_the_study_of_constants_would_write_of_names_values_and_subjects() -> None:
    """Where this fails, run `dvf-ig study constants --hearts 4 -o DIR` and take its constants.md."""
    _, *parts = PLACE.split(PAGE.read_text("utf-8"))
    on_page = {
        f"{place}.{name}": (value, subject)
        for place, table in zip(parts[::2], parts[1::2], strict=True)
        for name, value, subject in ROW.findall(table)
    }
    assert on_page == {c.label: (value_text(c.value), subject_of(c) or "") for c in registration_constants()}
