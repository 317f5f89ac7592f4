"""Options that do not go together, and files in the wrong place: one sentence, and nothing is written."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from toy_lab import SESSION, write_lab
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, NotConvergedError, Rigid
from dvf_ig.intake.schema import KEYS
from dvf_ig.io import write_coordinate_definitions, write_transform

START = {"start": {"transform": "start.tfm"}}
REGISTERED: dict[str, Any] = SESSION | START | {"calibration": {"probe": "probe.json", "latency": -0.065}}
OUT = ("-o", "out")


@pytest.fixture(scope="module")
def files(ball: DvfModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lab's files that fit, and others to take in their place."""
    folder = tmp_path_factory.mktemp("lab")
    write_lab(folder, ball)
    write_transform(Rigid.identity("mr", "tracker"), folder / "start.tfm")
    write_coordinate_definitions(folder / "device.xml", {"stylus_from_image": np.eye(4)})
    voxels = SimpleITK.GetImageFromArray(np.ones((9, 9, 9), np.uint8))
    SimpleITK.WriteImage(voxels, str(folder / "ed.nrrd"))
    SimpleITK.WriteImage(SimpleITK.JoinSeries([voxels] * 4), str(folder / "cine.nrrd"))
    grid = np.stack(np.meshgrid(*[np.arange(3) * 15.0] * 3), axis=-1).reshape(-1, 3)
    np.savetxt(folder / "touched.csv", grid, delimiter=",")
    np.savetxt(folder / "few.csv", grid[:3], delimiter=",")
    np.savetxt(folder / "patch.csv", 0.1 * grid, delimiter=",")
    (folder / "fixtures.yaml").write_text("fixtures: [{law: forbidden}]\n")
    return folder


@pytest.fixture
def lab(files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory; what would be registered or replayed is not."""
    monkeypatch.chdir(files)
    monkeypatch.setattr("dvf_ig.replay.registration.recorded_ultrasound", reached)
    monkeypatch.setattr("dvf_ig.replay.run_replay", reached)
    shutil.rmtree(files / "out", ignore_errors=True)
    return files


def reached(*_: object, **__: object) -> None:
    """Stands for the work that misuse must not reach."""
    raise NotConvergedError("the work began")


def session(folder: Path, document: dict[str, Any]) -> str:
    """The name of a session.yaml; a part that is None is left out."""
    (folder / "session.yaml").write_text(json.dumps({k: v for k, v in document.items() if v is not None}))
    return "session.yaml"


def ended(lab: Path, *arguments: str, code: int) -> str:
    """The sentence that a command ends with; no file is there that was not."""
    before = sorted(lab.rglob("*"))
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == code, done.output
    assert sorted(lab.rglob("*")) == before
    assert done.stdout == ""
    text = " ".join(done.stderr.replace("│", " ").split())
    assert text.count("error: ") + text.count("Invalid value") + text.count("Missing argument") == 1
    return text


def test_what_fits_gets_to_work(lab: Path) -> None:
    ended(lab, "register", session(lab, REGISTERED), *OUT, code=6)
    ended(lab, "register", session(lab, REGISTERED | TOUCHED), *OUT, code=6)
    ended(lab, "register", session(lab, SESSION), *OUT, code=6)
    ended(lab, "replay", session(lab, SESSION), *OUT, code=6)


TOUCHED = {"start": {"transform": "start.tfm", "touched": "touched.csv", "touched_phase": 0.35}}
BOTH = "give SESSION, a scenario folder (see `dvf-ig synth scenario`) or a session.yaml"
COMBINATIONS: dict[str, tuple[tuple[str, ...], str]] = {
    "nothing": (OUT, BOTH),
    "two kinds": (("session.yaml", "--fixed", "a.nrrd", "--moving", "b.nrrd", *OUT), "(got both)"),
    "half a pair": (("--moving", "a.nrrd", *OUT), "an image pair needs both --fixed US and --moving MR"),
    "a session's mask": (("session.yaml", "--mask", "m.nrrd", *OUT), "--mask goes with --fixed and --moving"),
    "a session's start": (("session.yaml", "--init", "start.tfm", *OUT), "--init goes with --fixed and"),
    "a pair's model": (
        ("--fixed", "a.nrrd", "--moving", "b.nrrd", "--model", "heart.npz", *OUT),
        "--model goes with SESSION alone",
    ),
    "a session and a model": (
        ("session.yaml", "--model", "heart.npz", *OUT),
        "session.yaml says whose model it is (preop.model): dvf-ig config init … --model FILE -o session",
    ),
    "no output": (("session.yaml",), "Missing option '-o' / '--out'"),
    "no output before": (("session.yaml", "--config", "session.yaml"), "there is no option --config"),
}


@pytest.mark.parametrize("case", COMBINATIONS)
def test_options_that_do_not_go_together(case: str, lab: Path) -> None:
    session(lab, REGISTERED)
    arguments, told = COMBINATIONS[case]
    before = sorted(lab.rglob("*"))
    done = CliRunner().invoke(app, ["register", *arguments])
    assert done.exit_code == 2, done.output
    assert sorted(lab.rglob("*")) == before
    assert told in " ".join(done.stderr.replace("│", " ").split())


@pytest.mark.parametrize("name", [name for name, key in KEYS.items() if key.option])
@pytest.mark.parametrize("command", ["register", "replay", "serve"])
def test_an_option_of_old_is_answered_with_its_key_and_the_line_that_sets_it(
    name: str, command: str, lab: Path
) -> None:
    for option in KEYS[name].options:
        done = CliRunner().invoke(app, [command, option, "x", "-o", "out"])
        told = " ".join(done.stderr.replace("│", " ").split())
        assert done.exit_code == 2
        if option != "--model":
            assert f"{option} is the key {name} of a session.yaml" in told
            assert f"dvf-ig config init … {KEYS[name].options[0]} {KEYS[name].metavar} -o" in told
            assert f"then dvf-ig {command} session.yaml" in told


@pytest.mark.parametrize("command", ["register", "replay", "serve"])
def test_the_option_config_is_answered_with_the_argument(command: str, lab: Path) -> None:
    done = CliRunner().invoke(app, [command, "--config=session.yaml", "-o", "out"])
    assert done.exit_code == 2
    told = " ".join(done.stderr.replace("│", " ").split())
    assert f"no option --config; give the file as the argument: dvf-ig {command} session.yaml" in told


INITS: dict[str, tuple[tuple[str, ...], int, str]] = {
    "nothing": ((), 2, "give --us SWEEP, or --us-volume FILE@PHASE"),
    "a word as rate": (("--us", "sweep.igs.mha", "--rate", "often"), 2, "'--rate'"),
    "a rate of no ECG": (("--us", "sweep.igs.mha", "--rate", "250"), 3, "--rate needs another option"),
    "labels of a model": (
        ("--us", "sweep.igs.mha", "--model", "heart.npz", "--cavity", "3"),
        3,
        "--cavity needs another option; also give --labels FILE",
    ),
    "labels in words": (
        ("--us", "sweep.igs.mha", "--labels", "ed.nrrd", "--organ", "heart"),
        3,
        "--organ is 'heart'; needed whole numbers such as 1,2,5",
    ),
    "a short fan": (("--us", "sweep.igs.mha", "--fan", "1,2,3"), 3, "--fan is '1,2,3'; needed five numbers"),
    "a phase in words": (
        ("--us", "sweep.igs.mha", "--touched", "few.csv@end"),
        3,
        "--touched is 'few.csv@end'",
    ),
    "a phase in percent": (("--us", "sweep.igs.mha", "--touched", "few.csv@35"), 3, "from 0 to below 1"),
    "a phase alone": (
        ("--us", "sweep.igs.mha", "--touched", "@0.3"),
        3,
        "--touched is '@0.3'; needed POINTS@PHASE",
    ),
}


@pytest.mark.parametrize("case", INITS)
def test_options_that_begin_no_session(case: str, lab: Path) -> None:
    arguments, code, told = INITS[case]
    assert told in ended(lab, "config", "init", *arguments, "-o", "begun.yaml", code=code)


def test_the_start_is_no_output(lab: Path) -> None:
    told = ended(lab, "register", session(lab, REGISTERED), "-o", "start.tfm", code=4)
    assert "cannot write start.tfm: a file of that name exists" in told


def at(key: str, value: Any) -> dict[str, Any]:
    """The session with one key changed."""
    section, _, entry = key.partition(".")
    return REGISTERED | {section: REGISTERED.get(section, {}) | {entry: value} if entry else value}


MISPLACED: dict[str, tuple[dict[str, Any], str]] = {
    "the tool as ultrasound": (
        at("ultrasound.file", "needle.igs.mha"),
        "it records tracker_from_needle; name what is meant (ultrasound.probe_name",
    ),
    "a model as ultrasound": (at("ultrasound.file", "heart.npz"), "heart.npz is not a sequence metafile"),
    "a name misspelt": (
        at("ultrasound.file", "swep.igs.mha"),
        "lacks swep.igs.mha (ultrasound.file), which session.yaml names",
    ),
    "a home that no shell saw": (at("ecg", "csv:~/ecg.csv"), "lacks ~/ecg.csv (ecg.file), which"),
    "a sequence as model": (
        at("preop.model", "sweep.igs.mha"),
        "preop.model: sweep.igs.mha is not a model file; build one with",
    ),
    "labels as cine": (at("preop.mr", "ed.nrrd"), "ed.nrrd is 3-D with 1 value(s) per voxel; needed 4-D"),
    "labels without cine": (at("preop", {"labels": "ed.nrrd"}), "ed.nrrd holds the labels of one phase"),
    "a label that is not there": (
        at("preop", {"labels": "cine.nrrd", "organ_labels": [7]}),
        "preop.organ_labels: cine.nrrd: the image has none of the labels 7; it has 1",
    ),
    "another patient": (
        at("patient_id", "P-17"),
        "heart.npz is the model of patient 'ball', needed patient 'P-17'",
    ),
    "a tip as probe": (
        at("calibration.probe", "tip.json"),
        "calibration.probe: tip.json is not a probe calibration but of kind 'tip'",
    ),
    "a device set without the image": (
        at("calibration.probe", "device.xml"),
        "device.xml has no transform probe_from_image",
    ),
    "milliseconds": (
        at("calibration.latency", -65.0),
        "calibration.latency: the latency is -65 s; needed -1 to 1 s (is it in ms?)",
    ),
    "a tip as latency": (
        at("calibration.latency", "tip.json"),
        "tip.json is not a latency but of kind 'tip'",
    ),
    "no ECG anywhere": (at("ecg", None), "sweep.igs.mha has no field whose name contains 'ecg'"),
    "points as ECG": (at("ecg", "touched.csv"), "touched.csv"),
    "landmarks as start": (
        at("start.transform", "model.mrk.json"),
        "start.transform: model.mrk.json is not a readable ITK transform",
    ),
    "a start as landmarks": (
        at("start", {"landmarks_mr": "start.tfm", "landmarks_tracker": "patient.mrk.json"}),
        "start.tfm has no landmark ending; needed .mrk.json, .fcsv or .tag",
    ),
    "a wrong sensor": (
        at("ultrasound.probe_name", "Stylus"),
        "it records tracker_from_probe; name what is meant (ultrasound.probe_name",
    ),
    "a sensor by number": (
        at("ultrasound.probe_name", "123"),
        "(ultrasound.probe_name, ultrasound.reference_name)",
    ),
    "three touched points": (
        at("start.touched", "few.csv"),
        "start.touched: few.csv: 3 points were touched on the surface; needed at",
    ),
    "points on one patch": (
        at("start.touched", "patch.csv"),
        "touch more of the surface, on several sides of the heart",
    ),
    "a transform as points": (at("start.touched", "start.tfm"), "needed points: rows of x, y, z in mm"),
    "a sector beyond the image": (
        at("ultrasound.fan", {"apex_px": [5000, 5], "start_px": 20, "stop_px": 40, "half_angle_rad": 0.3}),
        "ultrasound.fan: the sector covers 0.0% of the images",
    ),
}


@pytest.mark.parametrize("case", MISPLACED)
def test_a_file_in_the_wrong_place(case: str, lab: Path) -> None:
    document, told = MISPLACED[case]
    assert told in ended(lab, "register", session(lab, document), *OUT, code=3)


SESSIONS: dict[str, tuple[dict[str, Any], str]] = {
    "no tool": ({"tool": None}, "tool: a force needs the tool's poses"),
    "no tip": (
        {"calibration": {"tip": None}},
        "calibration.tip: a force needs a tool tip: dvf-ig calibrate pivot",
    ),
    "no start": ({"start": {}}, "start: a registration needs a start: a coarse mr_from_tracker (.tfm), or"),
    "no heart": ({"preop": None}, "session.yaml lacks preop: a registration needs the heart"),
    "milliseconds": ({"calibration": {"latency": -65.0}}, "calibration.latency: the latency is -65 s"),
    "ultrasound as tool": (
        {"tool": "sweep.igs.mha"},
        "sweep.igs.mha tracks the probe; give a sequence that tracks the tool",
    ),
    "a sensor by another name": (
        {"ultrasound": {"file": "sweep.igs.mha", "probe_name": "Stylus"}},
        "name what is meant (ultrasound.probe_name, ultrasound.reference_name)",
    ),
    "a name misspelt": (
        {"fixtures": "fixture.yaml"},
        "lacks fixture.yaml (fixtures), which session.yaml names",
    ),
    "few points beside a start": (
        {"start": {"transform": "start.tfm", "touched": "few.csv"}},
        "start.touched: few.csv: 3",
    ),
}


@pytest.mark.parametrize("case", SESSIONS)
def test_a_session_that_cannot_be_replayed(case: str, lab: Path) -> None:
    changed, told = SESSIONS[case]
    document = SESSION | changed | {"calibration": SESSION["calibration"] | changed.get("calibration", {})}
    assert told in ended(lab, "replay", session(lab, document), *OUT, code=3)


REPLAYS: dict[str, tuple[tuple[str, ...], int, str]] = {
    "nothing": ((), 2, "Missing argument 'SESSION'"),
    "a model": (
        ("session.yaml", "--model", "heart.npz"),
        2,
        "session.yaml says whose model it is (preop.model)",
    ),
    "two fixtures": (
        ("session.yaml", "--law", "guidance"),
        2,
        "the session describes the fixtures; leave out --law",
    ),
    "a file of fixtures": (("session.yaml", "--fixtures", "fixtures.yaml"), 2, "leave out --fixtures"),
    "no such file": (("none.yaml",), 3, "none.yaml does not exist; needed a session's configuration"),
    "a folder of something else": ((".",), 3, "is not a scenario folder: it has no scenario.yaml"),
    "a sequence": (("sweep.igs.mha",), 3, "sweep.igs.mha is not a session's configuration"),
}


@pytest.mark.parametrize("case", REPLAYS)
def test_a_replay_of_what_does_not_go_together(case: str, lab: Path) -> None:
    session(lab, SESSION | {"fixtures": [{"law": "forbidden"}]})
    arguments, code, told = REPLAYS[case]
    assert told in ended(lab, "replay", *arguments, *OUT, code=code)
