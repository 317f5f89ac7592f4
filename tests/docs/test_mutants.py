"""Every mutant of `scripts/mutate` can be applied: its text stands once in its file, its tests are there."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MUTANTS = tomllib.loads((ROOT / "scripts/mutants.toml").read_text(encoding="utf-8"))["mutant"]


def test_names_differ() -> None:
    assert len({one["name"] for one in MUTANTS}) == len(MUTANTS) > 100


def test_every_mutant_changes_one_place() -> None:
    stale = []
    for one in MUTANTS:
        path = ROOT / one["file"]
        count = path.read_text(encoding="utf-8").count(one["old"]) if path.is_file() else 0
        if count != 1 or one["old"] == one["new"]:
            stale.append(f"{one['name']}: its text stands {count} times in {one['file']}")
    assert not stale


def test_the_tests_that_should_notice_are_there() -> None:
    missing = [(one["name"], test) for one in MUTANTS for test in one["tests"] if not (ROOT / test).exists()]
    assert not missing
