"""`dvf-ig config init`: a lab's files become a SESSION.yaml that says what is still missing."""

import json
import re
from pathlib import Path

import pytest
import SimpleITK
import yaml
from config_runs import errors, run
from jsonschema import Draft202012Validator
from spoilt_lab import WRONG, image
from toy_lab import sweep, write_ecg
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app
from dvf_ig.core import UnreadableFileError
from dvf_ig.intake.fixtures import ForbiddenConfig
from dvf_ig.intake.schema import KEYS, SessionConfig
from dvf_ig.intake.session import open_session, read_session
from dvf_ig.intake.write import HEAD
from dvf_ig.io import add_ecg_field, read_ecg, write_sequence

ALL = {
    "--ecg": "csv:{lab}/ecg.csv",
    "--probe": "{lab}/probe.json",
    "--latency": "{lab}/latency.json",
    "--model": "{lab}/heart.npz",
    "--tool": "{lab}/needle.igs.mha",
    "--tip": "{lab}/tip.json",
}


def init(lab: Path, output: Path, *more: object, without: tuple[str, ...] = ()) -> Result:
    given = [word.format(lab=lab) for key, name in ALL.items() if key not in without for word in (key, name)]
    start = (
        () if "--landmarks" in without else ("--landmarks", lab / "model.mrk.json", lab / "patient.mrk.json")
    )
    return run("init", "--us", lab / "sweep.igs.mha", *given, *start, "-o", output, *more)


def test_init_writes_what_register_and_replay_read(lab: Path) -> None:
    (lab.parent / "case").mkdir()
    output = lab.parent / "case" / "session.yaml"
    done = init(lab, output)
    assert done.exit_code == 0, done.output
    anybody = (
        "note: nothing shows whose heart the model is; give its cine (--mr), or say whose it is (--patient)"
    )
    assert done.stderr == f"wrote {output}\n{anybody}\n"
    assert "replay             can run" in done.stdout
    assert "missing" not in done.stdout
    text = output.read_text()
    assert "  model: ../lab/heart.npz  #" in text
    assert "  file: csv:../lab/ecg.csv  # " in text.replace("'", "")
    document = yaml.safe_load(text)
    assert document["calibration"]["tip"] == "../lab/tip.json"
    recordings = read_session(output)
    assert recordings.scenario.tip is not None
    assert run("validate", output, "--for", "replay").exit_code == 0


def test_init_tries_what_register_would_try_first(files: Path, tmp_path: Path) -> None:
    """Files of which each can be read and all fit, but whose images show nothing that could be compared."""
    done = init(files, tmp_path / "session.yaml")
    assert done.exit_code == 3
    assert "ultrasound: 0 ultrasound frames can be compared with the model" in done.stderr
    assert "register           cannot run yet: ultrasound" in done.stdout
    assert not (tmp_path / "session.yaml").exists()


def test_init_again_takes_the_place_of_its_own_file_and_of_no_other(lab: Path) -> None:
    output = lab / "session.yaml"
    done = init(lab, output, without=("--tip",))
    assert done.exit_code == 0, done.output
    assert "dvf-ig calibrate pivot POSES -o tip.json (--tip FILE)" in done.stdout
    assert init(lab, output).exit_code == 0
    assert "  tip: tip.json" in output.read_text()
    for text in (output.read_text().replace("retiming", "Retiming"), "a: user's own\n"):
        output.write_text(text)
        done = init(lab, output)
        assert done.exit_code == 4
        assert "session.yaml: a file of that name exists that this program did not write" in done.stderr
        assert output.read_text() == text


def test_init_with_the_sweep_alone_writes_what_is_missing_as_comments(lab: Path) -> None:
    output = lab / "session.yaml"
    done = run("init", "--us", lab / "sweep.igs.mha", "-o", output)
    assert errors_of(done) == [
        f"{output} is written, but register cannot run yet; it lacks: ecg, preop, calibration.probe, "
        "calibration.latency, start"
    ]
    assert yaml.safe_load(output.read_text()) == {
        "schema": "dvf_ig.session/1",
        "ultrasound": {"file": "sweep.igs.mha"},
    }
    with pytest.raises(UnreadableFileError, match=r"session.yaml lacks preop: a registration needs"):
        read_session(output)
    opened = output.read_text().replace("\n# ecg:\n#   file: edf:ecg.edf", "\necg:\n  file: csv:ecg.csv")
    for key in ("preop:\n#   model", "calibration:\n#   probe", "start:\n#   transform"):
        assert f"\n# {key}" in opened
    output.write_text(opened)
    told = errors(run("validate", output))
    assert [sentence.partition(":")[0] for sentence in told] == [
        "preop",
        "calibration.probe",
        "calibration.latency",
        "start",
    ]


def errors_of(done: Result) -> list[str]:
    """The errors beside what was written."""
    assert done.exit_code == 3, done.output
    lines = done.stderr.strip().splitlines()
    return [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]


def test_an_ecg_in_the_sweep_needs_no_file(lab: Path) -> None:
    add_ecg_field(lab / "sweep.igs.mha", read_ecg(f"csv:{lab / 'ecg.csv'}"), lab / "sweep.igs.mha")
    output = lab / "session.yaml"
    done = init(lab, output, without=("--ecg",))
    assert done.exit_code == 0, done.output
    assert "ECG                II at 250 Hz, 0.0 to 12.0 s; 14 R peaks, 75 beats/min" in done.stdout
    assert "# Found: in the ultrasound's file: II at 250 Hz" in output.read_text()
    assert run("validate", output).exit_code == 0


def test_an_ecg_of_another_recorder_needs_its_beginning(lab: Path) -> None:
    write_ecg(lab / "ecg.csv", begin_s=5000.0)
    output = lab / "session.yaml"
    assert "say when on it the ECG began (--ecg-start)" in errors(init(lab, output))[0]
    assert init(lab, output, "--ecg-start", 0.25).exit_code == 0
    assert yaml.safe_load(output.read_text())["ecg"] == {"file": "csv:ecg.csv", "start_s": 0.25}
    assert run("validate", output, "--for", "replay").exit_code == 0


def test_a_trigger_takes_the_place_of_an_ecg(lab: Path) -> None:
    (lab / "pulses.csv").write_text("\n".join(str(0.4 + 0.8 * n) for n in range(14)) + "\n")
    output = lab / "session.yaml"
    done = init(lab, output, "--ecg", f"trigger:{lab / 'pulses.csv'}")
    assert done.exit_code == 0, done.output
    assert "trigger, 0.4 to 10.8 s; 14 R peaks, 75 beats/min" in done.stdout
    assert yaml.safe_load(output.read_text())["ecg"] == {"file": "trigger:pulses.csv"}


def test_the_tool_tracked_in_the_sweep_needs_no_file(lab: Path) -> None:
    write_sequence(sweep(also=("needle",)), lab / "sweep.igs.mha")
    output = lab / "session.yaml"
    done = init(lab, output, without=("--tool",))
    assert done.exit_code == 0, done.output
    assert "tool               tracker_from_needle tracked for 100%" in done.stdout
    assert "# Found: in the ultrasound's file: tracker_from_needle" in output.read_text()
    write_sequence(sweep(also=("needle", "clamp")), lab / "sweep.igs.mha")
    done = init(lab, output, without=("--tool", "--tip"))
    assert "one of clamp, needle: say which (tool.name)" in done.stdout
    assert init(lab, output, "--tool-name", "Needle", without=("--tool",)).exit_code == 0
    assert yaml.safe_load(output.read_text())["tool"] == {"file": "sweep.igs.mha", "name": "Needle"}


def test_nothing_is_written_where_a_file_is_wrong(lab: Path) -> None:
    (lab.parent / "case").mkdir()
    output = lab.parent / "case" / "session.yaml"
    for more, word in (
        (("--touched", lab / "none.csv"), "start.touched: "),
        (("--patient", "P-17"), "preop.model: "),
        (("--latency", "-65"), "(is it in ms?)"),
        (("--tip", lab / "probe.json"), "is not a tool tip but of kind 'probe'"),
    ):
        told = errors(init(lab, output, *more))
        assert len(told) == 1
        assert word in told[0]
        assert "/../" not in told[0]
        assert not output.exists()
    for empty in ("--patient", "--probe-name", "--tool-name"):
        assert "it is empty" in errors(init(lab, output, empty, ""))[0]
    assert "nan does not exist" in errors(init(lab, output, "--latency", "nan"))[0]
    assert init(lab, lab / "none" / "session.yaml").exit_code == 4
    lone = errors(run("init", "--us", lab / "sweep.igs.mha", "--cine", lab / "heart.npz", "-o", output))
    assert "--mr needs another option; also give --model FILE or --labels FILE" in lone[0]
    assert not output.exists()


def test_a_tool_that_only_a_replay_needs_does_not_keep_a_registration_back(lab: Path) -> None:
    WRONG["another day's tool"][0](lab, {})
    output = lab / "session.yaml"
    done = init(lab, output)
    assert done.exit_code == 0, done.output
    assert "replay             cannot run yet: tool.file" in done.stdout
    assert "note: a replay cannot use tool.file: " in done.stderr
    assert output.exists()


def test_init_takes_all_labels_and_says_which_there_are(lab: Path) -> None:
    labels = SimpleITK.Image((9, 9, 9), SimpleITK.sitkUInt8)
    labels[2:5, 2:5, 2:5] = 1
    labels[3, 3, 3] = 3
    labels.SetOrigin((-80.0, -80.0, -80.0))
    labels.SetSpacing((25.0, 25.0, 25.0))
    SimpleITK.WriteImage(labels, str(lab / "ed.nii.gz"))
    image("cine.nii.gz", 9, 9, 9, 4, origin_mm=-80.0, spacing_mm=25.0)(lab)
    output = lab / "session.yaml"
    done = init(
        lab, output, "--cine", lab / "cine.nii.gz", "--labels", lab / "ed.nii.gz", without=("--model",)
    )
    assert done.exit_code == 0, done.output
    assert "labels 1, 3 of end-diastole alone (phase 0)" in done.stdout
    assert "4 phases (times assumed: no timing.json)" in done.stdout
    assert yaml.safe_load(output.read_text())["preop"]["organ_labels"] == [1, 3]
    heart = ("--cine", lab / "cine.nii.gz", "--labels", lab / "ed.nii.gz")
    assert init(lab, output, *heart, "--organ", "3", "--cavity", "1", without=("--model",)).exit_code == 0
    preop = yaml.safe_load(output.read_text())["preop"]
    assert (preop["organ_labels"], preop["cavity_labels"]) == ([3], [1])
    assert (
        "--organ needs another option; also give --labels FILE"
        in errors(init(lab, output, "--organ", "3"))[0]
    )


def test_every_commented_line_says_a_key_that_is_known(lab: Path) -> None:
    output = lab / "session.yaml"
    run("init", "--us", lab / "sweep.igs.mha", "-o", output)
    opened = re.sub(r"^( *)# ( *(?:- \{)?[a-z_]+: ?.*)$", r"\1\2", output.read_text(), flags=re.MULTILINE)
    opened = opened.replace("#   - {law", "  - {law")
    output.write_text(opened)
    config = open_session(output)[0]
    given = config.model_dump(exclude_unset=True)
    assert given.keys() == SessionConfig.model_fields.keys() - {"name", "preset", "seed", "cap_n", "truth"}
    assert config.calibration.tip == "tip.json"
    assert config.fixtures
    assert config.fixtures[0] == ForbiddenConfig()


def test_the_schema_describes_every_key_and_accepts_what_init_writes(tmp_path: Path) -> None:
    file = tmp_path / "session.schema.json"
    done = CliRunner().invoke(app, ["config", "schema", "-o", str(file)])
    assert done.exit_code == 0, done.output
    schema = json.loads(file.read_text(encoding="utf-8"))
    judge = Draft202012Validator(schema)
    session = {
        "schema": "dvf_ig.session/1",
        "preop": {"model": "heart.npz"},
        "ultrasound": {"file": "us.mha"},
    }
    assert judge.is_valid(session)
    assert not judge.is_valid({**session, "preop": {"modell": "heart.npz"}})
    preop = schema["$defs"]["PreopConfig"]["properties"]
    assert preop["model"]["description"] == KEYS["preop.model"].note
    assert HEAD[0] == f"# yaml-language-server: $schema={file.name}"
