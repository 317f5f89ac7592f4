"""The study of wrongly prepared sessions: what its patterns name, and what its table says."""

import re

from dvf_ig.intake.findings import Disagreement
from dvf_ig.study.preparation import WAYS, _table


def test_causes_that_files_alone_show_are_sentences_of_the_check() -> None:
    sentences = [cause.value.sentence for cause in Disagreement]
    by_images = {"as it should be", "images mirrored", "another day's probe calibration"}
    by_images |= {"the same without landmarks"}
    for name, way in WAYS.items():
        found = [text for text in sentences if re.search(way.named.replace("in m,", r"in \{unit\},"), text)]
        assert bool(found) is (name not in by_images), name


def test_the_table_has_the_largest_force_and_error_of_each_way() -> None:
    line = {"way": "images mirrored", "named": True, "cause": "mirrored", "valid_s": 4.0, "hazard_s": 0.0}
    lines = [{**line, "force_s": 1.0, "tre_mm": 2.0}, {**line, "force_s": 3.0, "tre_mm": None}]
    rows = {row[0]: row for row in _table(lines)}
    assert rows["images mirrored"] == ("images mirrored", "2", "2", "4.0", "3.0", "0.0", "2.0", "mirrored")
    assert rows["as it should be"][1] == "0"
    assert len(rows) == 1 + len(WAYS)
