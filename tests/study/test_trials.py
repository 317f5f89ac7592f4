"""Trials: the same lines however they are worked out, and after a kill."""

import json
from pathlib import Path

import pytest

from dvf_ig.core import InvalidInputError
from dvf_ig.study.trials import Line, Settings, Study, run_trials


def work(settings: Settings, seed: int) -> Line:
    """Refuses multiples of 5."""
    if seed % 5 == 0:
        raise InvalidInputError(f"seed {seed} is refused")
    return {"value": settings["factor"] * seed}


def forbidden(settings: Settings, seed: int) -> Line:
    raise AssertionError(f"seed {seed} is done already")


STUDY = Study("multiples", {"factor": 3}, work)


def test_lines_come_in_the_order_of_the_seeds_and_refusals_are_lines(tmp_path: Path) -> None:
    shares: list[float] = []
    lines = run_trials(STUDY, [7, 5, 6], tmp_path, report=shares.append)
    assert lines == [
        {"seed": 7, "value": 21},
        {"seed": 5, "refused": "seed 5 is refused"},
        {"seed": 6, "value": 18},
    ]
    assert shares == pytest.approx([0, 1 / 3, 2 / 3, 1])


def test_a_killed_study_goes_on_where_it_was(tmp_path: Path) -> None:
    run_trials(STUDY, [1, 2, 3], tmp_path)
    path = tmp_path / "trials.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    again = run_trials(STUDY, [1, 2, 3, 4], tmp_path)
    assert [line["value"] for line in again] == [3, 6, 9, 12]
    assert path.read_bytes().startswith(whole)
    done = Study(STUDY.name, STUDY.settings, forbidden)
    assert run_trials(done, [4, 1], tmp_path) == [{"seed": 4, "value": 12}, {"seed": 1, "value": 3}]


def test_a_folder_holds_one_study(tmp_path: Path) -> None:
    run_trials(STUDY, [1], tmp_path)
    with pytest.raises(InvalidInputError, match="other settings"):
        run_trials(Study("multiples", {"factor": 4}, work), [1], tmp_path)
    assert json.loads((tmp_path / "study.json").read_text())["settings"] == {"factor": 3}


def test_misuse_and_damage_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="different seeds"):
        run_trials(STUDY, [1, 1], tmp_path)
    (tmp_path / "trials.jsonl").write_text("{broken\n")
    with pytest.raises(InvalidInputError, match="damaged"):
        run_trials(STUDY, [1], tmp_path)
