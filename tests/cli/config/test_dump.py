"""`dvf-ig config dump`: the complete configuration, which reads back to the same."""

import json
from pathlib import Path

from config_runs import errors, run, write
from toy_lab import SESSION

from dvf_ig.intake.scenario import session_of_scenario
from dvf_ig.intake.session import open_session


def test_a_dump_reads_back_to_the_same(lab: Path) -> None:
    path = write(
        lab, {**SESSION, "fixtures": [{"law": "guidance", "delta": 2.5}], "preop": {"model": "heart.npz"}}
    )
    done = run("dump", path)
    assert done.exit_code == 0
    assert "blend: force" in done.stdout
    again = lab / "again.yaml"
    again.write_text(done.stdout)
    assert open_session(again)[0] == open_session(path)[0]
    assert json.loads(run("dump", path, "--json").stdout)["fixtures"][0]["delta"] == 2.5


def test_a_scenario_folder_is_a_configuration(written: Path, tmp_path: Path) -> None:
    again = tmp_path / "session.yaml"
    again.write_text(run("dump", written).stdout)
    assert open_session(again)[0] == session_of_scenario(written)


def test_what_is_no_configuration_is_told(written: Path, tmp_path: Path) -> None:
    assert (
        "'dvf_ig.scenario/1'; needed 'dvf_ig.session/1': give its"
        in errors(run("dump", written / "scenario.yaml"))[0]
    )
    assert "is not a scenario folder" in errors(run("dump", tmp_path))[0]
    assert "does not exist" in errors(run("dump", tmp_path / "none.yaml"))[0]
