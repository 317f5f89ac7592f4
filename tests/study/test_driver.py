"""Trials: the same lines however they are worked out, and after a kill."""

import json
from pathlib import Path

import pytest
from multiples import deadly, mistaken, multiple, whereabouts

from dvf_ig.core import DvfIgError, InvalidInputError, OutputError
from dvf_ig.study.driver import Line, Settings, Trials, run_trials

TRIALS = Trials("multiples", {"factor": 3}, multiple)


def forbidden(settings: Settings, seed: int) -> Line:
    raise AssertionError(f"seed {seed} is done already")


def test_lines_come_in_the_order_of_the_seeds_and_refusals_are_lines(tmp_path: Path) -> None:
    shares: list[float] = []
    lines = run_trials(TRIALS, [7, 5, 6], tmp_path, progress=shares.append)
    assert lines == [
        {"seed": 7, "value": 21},
        {"seed": 5, "refused": "seed 5 is refused"},
        {"seed": 6, "value": 18},
    ]
    assert shares == pytest.approx([0, 1 / 3, 2 / 3, 1])


def test_a_killed_study_goes_on_where_it_was(tmp_path: Path) -> None:
    run_trials(TRIALS, [1, 2, 3], tmp_path)
    path = tmp_path / "trials.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    again = run_trials(TRIALS, [1, 2, 3, 4], tmp_path)
    assert [line["value"] for line in again] == [3, 6, 9, 12]
    assert path.read_bytes().startswith(whole)
    done = Trials(TRIALS.name, TRIALS.settings, forbidden)
    assert run_trials(done, [4, 1], tmp_path) == [{"seed": 4, "value": 12}, {"seed": 1, "value": 3}]


def test_a_group_stays_in_one_process_also_after_a_kill(tmp_path: Path) -> None:
    study = Trials("whereabouts", {"seconds": 0.01}, whereabouts)
    run_trials(study, [1, 4], tmp_path)
    shares: list[float] = []
    lines = run_trials(study, range(8), tmp_path, workers=2, group_size=4, progress=shares.append)
    assert [line["seed"] for line in lines] == list(range(8))
    processes = [line["process"] for line in lines]
    assert processes[1] == processes[4]
    assert processes[0] == processes[2] == processes[3] != processes[1]
    assert processes[5] == processes[6] == processes[7] != processes[4]
    assert shares == pytest.approx([2 / 8, 5 / 8, 1])
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 8


def test_a_worker_that_ends_is_a_sentence_and_what_was_done_is_kept(tmp_path: Path) -> None:
    run_trials(Trials("deadly", {"deadly": 3}, deadly), [1, 2], tmp_path)
    with pytest.raises(DvfIgError, match="run the study again to go on"):
        run_trials(Trials("deadly", {"deadly": 3}, deadly), [1, 2, 3, 4], tmp_path, workers=2)
    seeds = [json.loads(line)["seed"] for line in (tmp_path / "trials.jsonl").read_text().splitlines()]
    assert seeds in ([1, 2], [1, 2, 4])


def test_a_mistake_in_a_trial_is_no_line(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError, match="seed 1"):
        run_trials(Trials("mistaken", {}, mistaken), [1], tmp_path)
    assert (tmp_path / "trials.jsonl").read_text() == ""


def test_a_folder_holds_one_study(tmp_path: Path) -> None:
    run_trials(TRIALS, [1], tmp_path)
    with pytest.raises(InvalidInputError, match="other settings"):
        run_trials(Trials("multiples", {"factor": 4}, multiple), [1], tmp_path)
    assert json.loads((tmp_path / "study.json").read_text())["settings"] == {"factor": 3}


def test_misuse_and_damage_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="different seeds"):
        run_trials(TRIALS, [1, 1], tmp_path)
    with pytest.raises(InvalidInputError, match="groups of 0"):
        run_trials(TRIALS, [1], tmp_path, group_size=0)
    (tmp_path / "trials.jsonl").write_text("{mine}\n")
    with pytest.raises(OutputError, match=r"no study\.json names the study"):
        run_trials(TRIALS, [1], tmp_path)
    (tmp_path / "trials.jsonl").unlink()
    run_trials(TRIALS, [1], tmp_path)
    (tmp_path / "trials.jsonl").write_text("{broken\n")
    with pytest.raises(InvalidInputError, match="damaged"):
        run_trials(TRIALS, [1], tmp_path)
