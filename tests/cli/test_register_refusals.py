"""Options that do not go together, and files in the wrong place: one sentence, and nothing is written."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
import yaml
from toy_lab import SESSION, write_lab
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, NotConvergedError, Rigid
from dvf_ig.io import write_coordinate_definitions, write_transform

OPTIONS: dict[str, Any] = {
    "--us": "sweep.igs.mha",
    "--model": "heart.npz",
    "--probe": "probe.json",
    "--lag-s": -0.065,
    "--ecg": "csv:ecg.csv",
    "--start": "start.tfm",
}
VOLUMES: dict[str, Any] = {"--us-volume": "a.nrrd@0.1", "--model": "heart.npz", "--start": "start.tfm"}
MARKED = ("model.mrk.json", "patient.mrk.json")


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
    monkeypatch.setattr("dvf_ig.replay.register_scenario", reached)
    monkeypatch.setattr("dvf_ig.replay.run_replay", reached)
    shutil.rmtree(files / "out", ignore_errors=True)
    return files


def reached(*_: object, **__: object) -> None:
    """Stands for the work that misuse must not reach."""
    raise NotConvergedError("the work began")


def words(options: dict[str, Any]) -> list[str]:
    found: list[str] = []
    for name, value in options.items():
        given = value if isinstance(value, tuple) else (value,)
        found += [] if value is None else [name, *map(str, given)]
    return found


def ended(lab: Path, *arguments: str, code: int) -> str:
    """The sentence that a command ends with; no file is there that was not."""
    before = sorted(lab.rglob("*"))
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == code, done.output
    assert sorted(lab.rglob("*")) == before
    assert done.stdout == ""
    text = " ".join(done.stderr.replace("│", " ").split())
    assert text.count("error: ") + text.count("Invalid value") == 1
    return text


def test_what_fits_gets_to_work(lab: Path) -> None:
    (lab / "session.yaml").write_text(yaml.safe_dump(SESSION))
    ended(lab, "register", *words(OPTIONS), "-o", "out", code=6)
    ended(lab, "register", *words(OPTIONS | {"--touched": "touched.csv@0.35"}), "-o", "out", code=6)
    ended(lab, "register", "--config", "session.yaml", "-o", "out", code=6)
    ended(lab, "replay", "--config", "session.yaml", "-o", "out", code=6)


COMBINATIONS: dict[str, tuple[dict[str, Any], str]] = {
    "nothing": ({}, "what is to be registered? give one of SCENARIO, --config, --us, --us-volume, --fixed"),
    "two kinds": (OPTIONS | {"--config": "session.yaml"}, "(got --config, --us)"),
    "a pair beside": (OPTIONS | {"--fixed": "a.nrrd"}, "(got --us, --fixed and --moving)"),
    "half a pair": ({"--moving": "a.nrrd"}, "an image pair needs both --fixed US and --moving MR"),
    "a pair's mask": (OPTIONS | {"--mask": "m.nrrd"}, "--mask does not go with --us; it goes with --fixed"),
    "config and model": (
        {"--config": "session.yaml", "--model": "heart.npz"},
        "--model does not go with --config; it goes with SCENARIO, --us, --us-volume",
    ),
    "config and start": (
        {"--config": "session.yaml", "--start": "start.tfm"},
        "--start does not go with --config",
    ),
    "volumes and probe": (VOLUMES | {"--probe": "probe.json"}, "--probe does not go with --us-volume"),
    "volumes and touched": (VOLUMES | {"--touched": "touched.csv"}, "--touched does not go with --us-volume"),
    "volumes, two starts": (VOLUMES | {"--start-landmarks": MARKED}, "give either --start FILE.tfm or"),
    "volumes, no heart": (
        VOLUMES | {"--model": None},
        "whose heart? give --model MODEL, or --cine CINE with",
    ),
    "volumes, ECG unused": (
        VOLUMES | {"--ecg": "csv:ecg.csv"},
        "--ecg belongs to volumes given as FILE=SECONDS",
    ),
    "no heart": (
        OPTIONS | {"--model": None},
        "whose heart? give --model MODEL, or --cine CINE with --labels",
    ),
    "cine alone": (OPTIONS | {"--model": None, "--cine": "cine.nrrd"}, "whose heart?"),
    "two hearts": (
        OPTIONS | {"--labels": "ed.nrrd"},
        "--model, or --labels from which one is built, not both",
    ),
    "labels of a model": (OPTIONS | {"--cavity": "3"}, "--cavity says which of --labels are meant"),
    "labels in words": (
        OPTIONS | {"--model": None, "--labels": "ed.nrrd", "--organ": "heart"},
        "--organ is 'heart'; needed whole numbers such as 1,2,5",
    ),
    "no probe": (OPTIONS | {"--probe": None}, "--us needs --probe FILE, the probe's calibration"),
    "no latency": (
        OPTIONS | {"--lag-s": None},
        "latency of the video once: --lag-s SECONDS, or --latency JSON",
    ),
    "two latencies": (OPTIONS | {"--latency": "latency.json"}, "give the latency of the video once"),
    "seconds as a file": (OPTIONS | {"--lag-s": None, "--latency": "-0.065"}, "give seconds as --lag-s"),
    "a word as seconds": (OPTIONS | {"--lag-s": "late"}, "'--lag-s'"),
    "no start": (
        OPTIONS | {"--start": None},
        "--us needs a start: --start FILE.tfm, --start-landmarks MR TRACKER",
    ),
    "a rate of no ECG": (
        OPTIONS | {"--ecg": None, "--rate": 250},
        "--rate is of the recording that --ecg names",
    ),
    "a short fan": (OPTIONS | {"--fan": "1,2,3"}, "--fan is '1,2,3'; needed five numbers"),
    "a phase in words": (
        OPTIONS | {"--touched": "touched.csv@end"},
        "--touched: 'end' is no place in the cycle",
    ),
    "a phase in percent": (OPTIONS | {"--touched": "touched.csv@35"}, "needed a fraction from 0 to below 1"),
    "a phase alone": (
        OPTIONS | {"--touched": "@0.3"},
        "--touched is '@0.3'; needed a file of points before @",
    ),
    "no output": (OPTIONS | {"-o": None}, "say where to write: -o OUT"),
}


@pytest.mark.parametrize("case", COMBINATIONS)
def test_options_that_do_not_go_together(case: str, lab: Path) -> None:
    options, told = COMBINATIONS[case]
    assert told in ended(lab, "register", *words({"-o": "out"} | options), code=2)


def test_the_start_is_no_output(lab: Path) -> None:
    told = ended(lab, "register", *words(OPTIONS | {"-o": "start.tfm"}), code=4)
    assert "cannot write start.tfm: a file of that name exists" in told


MISPLACED: dict[str, tuple[dict[str, Any], str]] = {
    "the tool as ultrasound": (
        {"--us": "needle.igs.mha"},
        "it records tracker_from_needle; name the sensors",
    ),
    "a model as ultrasound": ({"--us": "heart.npz"}, "heart.npz is not a sequence metafile"),
    "a name misspelt": ({"--us": "swep.igs.mha"}, "lacks swep.igs.mha (--us), which the command names"),
    "a home that no shell saw": (
        {"--ecg": "csv:~/ecg.csv"},
        "lacks ~/ecg.csv (--ecg), which the command names",
    ),
    "a sequence as model": (
        {"--model": "sweep.igs.mha"},
        "sweep.igs.mha is not a model file; build one with",
    ),
    "labels as cine": ({"--cine": "ed.nrrd"}, "ed.nrrd is 3-D with 1 value(s) per voxel; needed 4-D"),
    "labels without cine": (
        {"--model": None, "--labels": "ed.nrrd"},
        "ed.nrrd holds the labels of one phase",
    ),
    "a label that is not there": (
        {"--model": None, "--labels": "cine.nrrd", "--organ": "7"},
        "--organ: the image has none of the labels 7; it has 1",
    ),
    "another patient": (
        {"--patient": "P-17"},
        "heart.npz is the model of patient 'ball', needed patient 'P-17'",
    ),
    "a tip as probe": ({"--probe": "tip.json"}, "tip.json is not a probe calibration but of kind 'tip'"),
    "a device set without the image": (
        {"--probe": "device.xml"},
        "device.xml has no transform probe_from_image",
    ),
    "milliseconds": ({"--lag-s": -65}, "--lag-s: the latency is -65 s; needed -1 to 1 s (is it in ms?)"),
    "no number": ({"--lag-s": "nan"}, "--lag-s: Input should be a finite number"),
    "a tip as latency": (
        {"--lag-s": None, "--latency": "tip.json"},
        "tip.json is not a latency but of kind 'tip'",
    ),
    "no ECG anywhere": ({"--ecg": None}, "sweep.igs.mha has no field whose name contains 'ecg'"),
    "points as ECG": ({"--ecg": "touched.csv"}, "touched.csv"),
    "landmarks as start": ({"--start": "model.mrk.json"}, "model.mrk.json is not a readable ITK transform"),
    "a start as landmarks": (
        {"--start": None, "--start-landmarks": ("start.tfm", MARKED[1])},
        "start.tfm has no landmark ending; needed .mrk.json, .fcsv or .tag",
    ),
    "a wrong sensor": (
        {"--probe-name": "Stylus"},
        "it records tracker_from_probe; name the sensors (--probe-name",
    ),
    "a sensor by number": ({"--probe-name": "123"}, "(--probe-name, --reference-name)"),
    "three touched points": (
        {"--touched": "few.csv"},
        "--touched: 3 points were touched on the surface; needed at",
    ),
    "points on one patch": (
        {"--touched": "patch.csv"},
        "touch more of the surface, on several sides of the heart",
    ),
    "a transform as points": ({"--touched": "start.tfm"}, "is not x,y,z in mm"),
    "a sector beyond the image": (
        {"--fan": "5000,5,20,40,0.3"},
        "--fan: the sector covers 0.0% of the images",
    ),
}


@pytest.mark.parametrize("case", MISPLACED)
def test_a_file_in_the_wrong_place(case: str, lab: Path) -> None:
    changed, told = MISPLACED[case]
    assert told in ended(lab, "register", *words(OPTIONS | changed), "-o", "out", code=3)


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
        "name the sensors (ultrasound.probe_name, ultrasound.reference_name)",
    ),
    "a name misspelt": (
        {"fixtures": "fixture.yaml"},
        "lacks fixture.yaml (fixtures), which session.yaml names",
    ),
    "few points beside a start": (
        {"start": {"transform": "start.tfm", "touched": "few.csv"}},
        "start.touched: 3",
    ),
}


@pytest.mark.parametrize("case", SESSIONS)
def test_a_session_that_cannot_be_replayed(case: str, lab: Path) -> None:
    changed, told = SESSIONS[case]
    document = SESSION | changed | {"calibration": SESSION["calibration"] | changed.get("calibration", {})}
    (lab / "session.yaml").write_text(json.dumps({k: v for k, v in document.items() if v is not None}))
    assert told in ended(lab, "replay", "--config", "session.yaml", "-o", "out", code=3)


REPLAYS: dict[str, tuple[tuple[str, ...], int, str]] = {
    "nothing": ((), 2, "what is to be replayed? give a scenario folder, or --config SESSION.yaml"),
    "two": (
        (".", "--config", "session.yaml"),
        2,
        "give a scenario folder or --config SESSION.yaml, not both",
    ),
    "a model": (
        ("--config", "session.yaml", "--model", "heart.npz"),
        2,
        "session.yaml says whose model it is",
    ),
    "two fixtures": (
        ("--config", "session.yaml", "--law", "guidance"),
        2,
        "the SESSION.yaml describes the fixtures; leave out --law",
    ),
    "a file of fixtures": (
        ("--config", "session.yaml", "--fixtures", "fixtures.yaml"),
        2,
        "leave out --fixtures",
    ),
    "a file as folder": (("session.yaml",), 3, "it is a file (a SESSION.yaml is given as --config)"),
    "no such file": (
        ("--config", "none.yaml"),
        3,
        "none.yaml does not exist; needed a session's configuration",
    ),
    "a sequence": (("--config", "sweep.igs.mha"), 3, "sweep.igs.mha is not a session's configuration"),
}


@pytest.mark.parametrize("case", REPLAYS)
def test_a_replay_of_what_does_not_go_together(case: str, lab: Path) -> None:
    (lab / "session.yaml").write_text(yaml.safe_dump(SESSION | {"fixtures": [{"law": "forbidden"}]}))
    arguments, code, told = REPLAYS[case]
    assert told in ended(lab, "replay", *arguments, "-o", "out", code=code)
