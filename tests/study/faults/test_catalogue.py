"""The table of the study of faults covers every hazard, and each severity is one that must be detected."""

import pytest

from dvf_ig.guidance import Hazard
from dvf_ig.study.faults.catalogue import ROWS
from dvf_ig.study.faults.start_trial import StartFault


@pytest.mark.parametrize("hazard", list(Hazard), ids=lambda hazard: hazard.name)
def test_every_hazard_has_a_row(hazard: Hazard) -> None:
    """Fails where a hazard is added without a row."""
    assert any(hazard in row.hazards for row in ROWS)


def test_rows_are_told_apart_by_their_names_and_severities_by_their_labels() -> None:
    assert len({row.name for row in ROWS}) == len(ROWS)
    assert all(len({one.label for one in row.severities}) == 3 for row in ROWS)


def test_every_row_says_where_its_limit_comes_from() -> None:
    for row in ROWS:
        assert row.limit
        at_start = isinstance(row.severities[0].fault, StartFault)
        assert at_start == (row.hazards is Hazard.NONE)
        assert all((one.limit_s > 0.0) != at_start for one in row.severities)
