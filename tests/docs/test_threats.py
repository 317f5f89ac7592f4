"""Every claim of the page about files names tests that exist."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "dvf_ig" / "docs" / "guide" / "threats.md").read_text(encoding="utf-8")


def test_the_tests_that_hold_a_claim_exist() -> None:
    named = re.findall(r"`([\w/]+\.py)::(\w+)`", PAGE)
    assert len(named) > 30
    for file, name in named:
        tree = ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, (file, name)


def test_every_row_of_a_table_of_dangers_is_held() -> None:
    for table in re.findall(r"(\|[^\n]*\| held by \|\n\|[-|]+\|\n)((?:\|[^\n]*\n)+)", PAGE):
        rows = table[1].splitlines()
        assert len(rows) >= 5
        assert all("::test_" in row for row in rows)
