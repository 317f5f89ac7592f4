"""Several files take their places together, or none does."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from dvf_ig.core import OutputError
from dvf_ig.io import files_together


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


def write_a_and(then: Callable[[Path], object], folder: Path) -> None:
    with files_together(folder, ("a", "b")) as new:
        (new / "a").write_text("new")
        then(new)


def test_all_take_their_places_and_what_is_left_out_goes(tmp_path: Path) -> None:
    for name in ("a", "b", "other"):
        (tmp_path / name).write_text("old")
    with files_together(tmp_path, ("a", "b", "c")) as new:
        (new / "a").write_text("new")
        (new / "c").write_text("new")
        assert contents(tmp_path) == {"a": "old", "b": "old", "other": "old"}
    assert contents(tmp_path) == {"a": "new", "c": "new", "other": "old"}
    assert len(list(tmp_path.iterdir())) == 3


def test_none_where_the_block_fails(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(ZeroDivisionError):
        write_a_and(lambda _: 1 / 0, tmp_path)
    assert contents(tmp_path) == {"a": "old"}
    assert len(list(tmp_path.iterdir())) == 1


def test_none_where_a_place_cannot_be_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_text("old")
    (tmp_path / "b").mkdir()
    with pytest.raises(OutputError, match="it is a folder"):
        write_a_and(lambda new: (new / "b").write_text("new"), tmp_path)
    assert contents(tmp_path) == {"a": "old"}
    (tmp_path / "b").rmdir()
    rename = os.rename

    def full(source: Path, target: Path) -> None:
        if target == tmp_path / "b":
            raise OSError(28, "No space left on device")
        rename(source, target)

    monkeypatch.setattr(os, "rename", full)
    with pytest.raises(OutputError, match="No space left"):
        write_a_and(lambda new: (new / "b").write_text("new"), tmp_path)
    assert contents(tmp_path) == {"a": "old"}
    assert len(list(tmp_path.iterdir())) == 1
