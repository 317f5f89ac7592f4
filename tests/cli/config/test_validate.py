"""`dvf-ig config validate`: what is wrong is named by file and key, with what to do."""

import json
import shutil
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from config_runs import errors, run, write
from recorded import pivot_of
from spoilt_lab import WRONG
from toy_lab import SESSION, write_lab

from dvf_ig.core import InvalidInputError, NoOverlapError, Scenario
from dvf_ig.intake import read_session
from dvf_ig.intake.fit import require_fit
from dvf_ig.io import write_poses


def test_files_that_fit_pass(lab: Path) -> None:
    path = write(lab, SESSION)
    for purpose in ([], ["--for", "register"], ["--for", "replay"]):
        done = run("validate", path, *purpose)
        assert done.exit_code == 0, done.output
        assert done.stderr == ""
    assert "model of patient 'ball', EPICARDIAL, 4 phases" in done.stdout
    assert "4 landmarks named in both files, residual 0.0 mm RMS" in done.stdout
    told = json.loads(run("validate", path, "--json").stdout)
    assert told["ready"] == {"register": True, "replay": True}
    assert told["problems"] == []


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_configuration_is_told_by_file_and_key_and_what_to_do(case: str, lab: Path) -> None:
    spoil, words = WRONG[case]
    document = deepcopy(SESSION)
    spoil(lab, document)
    told = errors(run("validate", write(lab, document)))
    assert len(told) == 1, told
    for word in words:
        assert word in told[0]


def test_all_problems_are_told_in_one_run(lab: Path) -> None:
    document = deepcopy(SESSION)
    for case in ("a refused calibration", "a latency in ms", "two common landmarks", "another day's tool"):
        WRONG[case][0](lab, document)
    done = run("validate", write(lab, document), "--json")
    keys = ["calibration.latency", "calibration.tip", "start.landmarks_tracker", "tool.file"]
    assert sorted(sentence.partition(":")[0] for sentence in errors(done)) == keys
    told = json.loads(done.stdout)
    assert sorted(problem["key"] for problem in told["problems"]) == keys
    assert told["ready"] == {"register": False, "replay": False}
    assert told["parts"]["calibration.tip"] is None


def test_what_a_purpose_does_not_need_is_not_asked_for(lab: Path) -> None:
    document = deepcopy(SESSION)
    del document["tool"], document["calibration"]["tip"]
    path = write(lab, document)
    assert run("validate", path).exit_code == 0
    told = errors(run("validate", path, "--for", "replay"))
    assert told == errors(run("validate", write(lab, {**document, "tool": None}), "--for", "replay"))
    assert [sentence.partition(":")[0] for sentence in told] == ["tool", "calibration.tip"]
    WRONG["a tool that was never tracked"][0](lab, document)
    path = write(lab, {**document, "tool": "needle.igs.mha"})
    assert run("validate", path, "--for", "register").exit_code == 0
    assert run("validate", path).exit_code == 3


def test_what_was_read_is_checked_by_the_same_rules(lab: Path) -> None:
    recordings = read_session(write(lab, SESSION))
    require_fit(recordings, "replay")
    for case, use, error, words in (
        ("another day's tool", "replay", NoOverlapError, "tool.file: .*/needle.igs.mha: ECG"),
        (
            "two common landmarks",
            "register",
            InvalidInputError,
            "start.landmarks_tracker: .*model and patient",
        ),
        ("no start", "register", InvalidInputError, "start: a registration needs a start"),
    ):
        document = deepcopy(SESSION)
        WRONG[case][0](lab, document)
        spoilt = read_session(write(lab, document))
        key, said = words.split(": ", maxsplit=1)
        with pytest.raises(error, match=said) as refused:
            require_fit(spoilt, use)
        assert refused.value.key == key
        if use == "replay":
            require_fit(spoilt, "register")
        write_lab(lab, recordings.model)


def test_a_scenario_folder_is_checked_with_its_calibrations(
    written: Path, scenario: Scenario, tmp_path: Path
) -> None:
    done = run("validate", written, "--for", "replay")
    assert done.exit_code == 0, done.output
    folder = Path(shutil.copytree(written, tmp_path / "scenario"))
    still = pivot_of(scenario)
    held = {"rotations": still.rotations, "translations_mm": still.translations_mm}
    held = {name: np.repeat(values[:1], len(still), axis=0) for name, values in held.items()}
    write_poses(replace(still, **held), folder / "calibration" / "pivot.igs.mha")
    told = errors(run("validate", folder))
    assert told[0].startswith("calibration: pivot calibration: ")
