"""`dvf-ig config`: a lab's files become a SESSION.yaml; what is wrong with them is named by file and key."""

import json
import shutil
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
import yaml
from recorded import pivot_of
from toy_lab import SESSION, poses, sweep, write_calibration, write_ecg, write_lab
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, InvalidInputError, Landmarks, NoOverlapError, Points, Rigid, Scenario
from dvf_ig.io import (
    add_ecg_field,
    read_ecg,
    write_coordinate_definitions,
    write_landmarks,
    write_poses,
    write_sequence,
    write_transform,
)
from dvf_ig.io.scenario.read import read_scenario_session
from dvf_ig.io.session_file.draft import SessionDraft
from dvf_ig.io.session_file.fit import require_fit
from dvf_ig.io.session_file.read import read_session, read_session_config
from dvf_ig.io.session_file.schema import SessionConfig

Document = dict[str, Any]
Spoil = Callable[[Path, Document], None]


@pytest.fixture(scope="module")
def files(ball: DvfModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    write_lab(folder, ball)
    return folder


@pytest.fixture
def lab(files: Path, tmp_path: Path) -> Path:
    """A lab's folder, to be spoilt."""
    return Path(shutil.copytree(files, tmp_path / "lab"))


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["config", *map(str, arguments)])


def write(folder: Path, document: Document) -> Path:
    path = folder / "session.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def errors(done: Result) -> list[str]:
    assert done.exit_code == 3, done.output
    lines = done.stderr.strip().splitlines()
    assert all(line.startswith("error: ") for line in lines), done.stderr
    return [line.removeprefix("error: ") for line in lines]


# validate


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


def put(key: str, value: Any) -> Spoil:
    """Set, or with None remove, a key of the document."""

    def spoil(_folder: Path, document: Document) -> None:
        *sections, last = key.split(".")
        for section in sections:
            document = document.setdefault(section, {})
        if value is None:
            del document[last]
        else:
            document[last] = value

    return spoil


def both(*steps: Spoil) -> Spoil:
    def spoil(folder: Path, document: Document) -> None:
        for step in steps:
            step(folder, document)

    return spoil


def file(write_file: Callable[[Path], object]) -> Spoil:
    """Spoil a file."""
    return lambda folder, _document: (write_file(folder), None)[1]


def truncate(folder: Path) -> None:
    path = folder / "sweep.igs.mha"
    path.write_bytes(path.read_bytes()[:-9000])


def change_byte(folder: Path) -> None:
    data = bytearray((folder / "heart.npz").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (folder / "heart.npz").write_bytes(data)


def landmarks(*names: str) -> Callable[[Path], None]:
    at = np.random.default_rng(3).normal(size=(len(names), 3)) * 30
    return lambda folder: write_landmarks(
        Landmarks(names, Points("tracker", at)), folder / "patient.mrk.json"
    )


def image(name: str, *size: int, value: int = 1) -> Callable[[Path], None]:
    def write_image(folder: Path) -> None:
        voxels = np.full(size[:3][::-1], value, np.uint8)
        phases = [SimpleITK.GetImageFromArray(voxels)] * (size[3] if len(size) > 3 else 1)
        made = phases[0] if len(size) == 3 else SimpleITK.JoinSeries(phases)
        made.SetOrigin((90.0,) * len(size))
        SimpleITK.WriteImage(made, str(folder / name))

    return write_image


def inverse_start(folder: Path) -> None:
    write_transform(Rigid.identity("tracker", "mr"), folder / "start.tfm")


def device_set(folder: Path) -> None:
    write_coordinate_definitions(folder / "device.xml", {"stylus_from_image": np.eye(4)})


def few_points(folder: Path) -> None:
    (folder / "touched.csv").write_text("x,y,z\n0,0,0\n10,0,0\n0,10,0\n")


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 1234567\n"

WRONG: dict[str, tuple[Spoil, list[str]]] = {
    "a name misspelt": (
        put("calibration.tip", "tp.json"),
        ["calibration.tip: ", "lab/tp.json does not exist; copy it there, or mend its name"],
    ),
    "an unknown key": (
        put("calibration.stylus", "tip.json"),
        ["session.yaml: calibration: unknown key stylus; needed some of probe, latency, tip"],
    ),
    "a calibration left out": (
        put("calibration.probe", None),
        [
            "calibration.probe: a registration needs",
            "dvf-ig calibrate probe SWEEP --device-set XML -o probe.json",
        ],
    ),
    "one file of landmarks": (
        put("start.landmarks_tracker", None),
        ["session.yaml: start: landmarks need both landmarks_mr and landmarks_tracker"],
    ),
    "a sweep that Git-LFS left": (
        file(lambda folder: (folder / "sweep.igs.mha").write_bytes(LFS)),
        ["ultrasound.file: ", "sweep.igs.mha is a Git-LFS pointer", "git lfs pull"],
    ),
    "a truncated sweep": (
        file(truncate),
        ["ultrasound.file: ", "sweep.igs.mha", "is truncated", "copy or record it again"],
    ),
    "a sweep of poses alone": (
        file(lambda folder: write_sequence(sweep(images=False), folder / "sweep.igs.mha")),
        ["ultrasound.file: ", "sweep.igs.mha", "no images; record the ultrasound's video with them"],
    ),
    "a probe that was never tracked": (
        file(lambda folder: write_sequence(sweep(tracked=False), folder / "sweep.igs.mha")),
        ["ultrasound.file: ", "sweep.igs.mha", "none of the 220 poses", "check the line of sight"],
    ),
    "a probe by another name": (
        file(lambda folder: write_sequence(sweep(probe="us_head"), folder / "sweep.igs.mha")),
        ["ultrasound.file: ", "sweep.igs.mha", "it records tracker_from_us_head", "ultrasound.probe_name"],
    ),
    "another day's ECG": (
        file(lambda folder: write_ecg(folder / "ecg.csv", begin_s=5000.0)),
        [
            "ecg.file: ",
            "ecg.csv: ECG (5000",
            "ultrasound (0.5 to 11.4 s) share less than a second",
            "one clock",
        ],
    ),
    "an ECG without beats": (
        file(lambda folder: write_ecg(folder / "ecg.csv", height=0.0)),
        ["ecg.file: ", "ecg.csv", "R peaks", "check the electrodes and the lead"],
    ),
    "an ECG without times": (
        file(lambda folder: write_ecg(folder / "ecg.csv", times=False)),
        ["ecg.file: ", "ecg.csv", "ecg.rate_hz"],
    ),
    "an ECG of no known kind": (
        put("ecg", "heart.npz"),
        ["ecg.file: ", "heart.npz' names no ECG; write wfdb:RECORD, edf:FILE, csv:FILE"],
    ),
    "a calibration of another sensor": (
        file(
            lambda folder: write_calibration(
                folder / "probe.json", "probe", sensor_frame="stylus", sensor_from_image=np.eye(4).tolist()
            )
        ),
        ["calibration.probe: ", "probe.json calibrates 'stylus'; needed 'probe'", "ultrasound.probe_name"],
    ),
    "a device set without the image": (
        both(file(device_set), put("calibration.probe", "device.xml")),
        ["calibration.probe: ", "device.xml has no transform probe_from_image; it has stylus_from_image"],
    ),
    "a refused calibration": (
        file(
            lambda folder: write_calibration(
                folder / "tip.json", "tip", ("RMS is 2.2 mm",), tip_mm=[0, 0, 1], tip_frame="needle"
            )
        ),
        ["calibration.tip: ", "tip.json is a calibration that was refused: RMS is 2.2 mm; calibrate again"],
    ),
    "a calibration in metres": (
        file(
            lambda folder: write_calibration(
                folder / "probe.json",
                "probe",
                sensor_frame="probe",
                sensor_from_image=np.diag([5e-4, 5e-4, 1, 1]).tolist(),
            )
        ),
        ["calibration.probe: ", "probe.json", "0.04 mm deep; needed 10 to 500 mm", "in mm"],
    ),
    "a latency in ms": (
        put("calibration.latency", -65.0),
        ["calibration.latency: the latency is -65 s; needed -1 to 1 s (is it in ms?)"],
    ),
    "tip and latency swapped": (
        both(put("calibration.latency", "tip.json"), put("calibration.tip", None)),
        ["calibration.latency: ", "tip.json is not a latency but of kind 'tip'", "calibrate latency -o FILE"],
    ),
    "the tip of another tool": (
        file(
            lambda folder: write_calibration(
                folder / "tip.json", "tip", tip_mm=[0, 0, 150], tip_frame="stylus"
            )
        ),
        [
            "calibration.tip: ",
            "tip.json is the tip of 'stylus', but the recorded tool is 'needle'",
            "tool.name",
        ],
    ),
    "a tool that was never tracked": (
        file(lambda folder: write_poses(poses("needle", tracked=False), folder / "needle.igs.mha")),
        ["tool.file: ", "needle.igs.mha", "none of the 360 poses", "check the line of sight"],
    ),
    "another day's tool": (
        file(lambda folder: write_poses(poses("needle", 900.0), folder / "needle.igs.mha")),
        ["tool.file: ", "needle.igs.mha", "tool (900.0 to 912.0 s) share less than a second", "one clock"],
    ),
    "two common landmarks": (
        file(landmarks("apex", "mitral", "Aorta", "Tricuspid")),
        [
            "start.landmarks_tracker: ",
            "patient.mrk.json",
            "share 2 landmark names (apex, mitral)",
            "alike in both",
        ],
    ),
    "a start in the other direction": (
        both(file(inverse_start), put("start.transform", "start.tfm")),
        ["start.transform: ", "start.tfm is tracker_from_mr; needed mr_from_tracker"],
    ),
    "three touched points": (
        both(file(few_points), put("start.touched", "touched.csv")),
        ["start.touched: ", "touched.csv", "3 points were touched on the surface; needed at least"],
    ),
    "no start": (
        put("start", None),
        ["start: a registration needs a start: a coarse mr_from_tracker (.tfm)"],
    ),
    "another patient's model": (
        put("patient_id", "P-17"),
        [
            "preop.model: ",
            "heart.npz is the model of patient 'ball', needed patient 'P-17'",
            "name the other data alike",
        ],
    ),
    "a damaged model": (
        file(change_byte),
        ["preop.model: ", "heart.npz is not an intact model file", "build it again"],
    ),
    "labels of end-diastole alone": (
        both(file(image("labels.nrrd", 9, 9, 9)), put("preop", {"labels": "labels.nrrd"})),
        ["preop.labels: ", "labels.nrrd holds the labels of one phase; give mr, the cine"],
    ),
    "labels that no voxel has": (
        both(
            file(image("labels.nrrd", 9, 9, 9, 4)),
            put("preop", {"labels": "labels.nrrd", "organ_labels": [7]}),
        ),
        ["preop.organ_labels: ", "labels.nrrd: the image has none of the labels 7; it has 1"],
    ),
    "a cine of somebody else": (
        both(file(image("cine.nrrd", 9, 9, 9, 4)), put("preop.mr", "cine.nrrd")),
        ["preop.mr: ", "cine.nrrd", "of the model's surface lies in these images"],
    ),
    "a fixture without sense": (
        put("fixtures", [{"law": "forbidden", "gamma": -1.0}]),
        ["fixtures: ", "session.yaml: fixtures.0: ", "gamma"],
    ),
}


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
    assert [sentence.partition(":")[0] for sentence in told] == ["tool", "calibration.tip"]
    WRONG["a tool that was never tracked"][0](lab, document)
    path = write(lab, {**document, "tool": "needle.igs.mha"})
    assert run("validate", path, "--for", "register").exit_code == 0
    assert run("validate", path).exit_code == 3


def test_what_was_read_is_checked_by_the_same_rules(lab: Path) -> None:
    recordings = read_session(write(lab, SESSION))
    require_fit(recordings, "replay")
    for case, use, error, words in (
        ("another day's tool", "replay", NoOverlapError, "tool: ECG"),
        ("two common landmarks", "register", InvalidInputError, "start.landmarks_tracker: model and patient"),
        ("no start", "register", InvalidInputError, "start: a registration needs a start"),
    ):
        document = deepcopy(SESSION)
        WRONG[case][0](lab, document)
        spoilt = read_session(write(lab, document))
        with pytest.raises(error, match=f"^{words}"):
            require_fit(spoilt, use)
        if use == "replay":
            require_fit(spoilt, "register")
        write_lab(lab, recordings.model)


# init

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
    assert done.stderr == f"wrote {output}\n"
    assert "replay             can run" in done.stdout
    assert "missing" not in done.stdout
    text = output.read_text()
    assert "  model: ../lab/heart.npz  #" in text
    assert "  file: csv:../lab/ecg.csv\n" in text.replace("'", "")
    document = yaml.safe_load(text)
    assert document["calibration"]["tip"] == "../lab/tip.json"
    recordings = read_session(output)
    assert recordings.scenario.tip is not None
    assert run("validate", output, "--for", "replay").exit_code == 0


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
        assert "session.yaml: a file of that name exists that config init did not write" in done.stderr
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
    assert "which is it: clamp, needle? (tool.name)" in done.stdout
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
    assert "give --labels LABELS" in lone[0]
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
    labels.SetOrigin((90.0, 90.0, 90.0))
    SimpleITK.WriteImage(labels, str(lab / "ed.nii.gz"))
    image("cine.nii.gz", 9, 9, 9, 4)(lab)
    output = lab / "session.yaml"
    done = init(
        lab, output, "--cine", lab / "cine.nii.gz", "--labels", lab / "ed.nii.gz", without=("--model",)
    )
    assert done.exit_code == 0, done.output
    assert "labels 1, 3 of end-diastole alone (phase 0)" in done.stdout
    assert "4 phases (times assumed: no timing.json)" in done.stdout
    assert yaml.safe_load(output.read_text())["preop"]["organ_labels"] == [1, 3]


# dump


def test_a_dump_reads_back_to_the_same(lab: Path) -> None:
    path = write(
        lab, {**SESSION, "fixtures": [{"law": "guidance", "delta": 2.5}], "preop": {"model": "heart.npz"}}
    )
    done = run("dump", path)
    assert done.exit_code == 0
    assert "blend: force" in done.stdout
    again = lab / "again.yaml"
    again.write_text(done.stdout)
    assert read_session_config(again) == read_session_config(path)
    assert SessionDraft.model_fields.keys() == SessionConfig.model_fields.keys()
    assert json.loads(run("dump", path, "--json").stdout)["fixtures"][0]["delta"] == 2.5


def test_a_scenario_folder_is_a_configuration(written: Path, scenario: Scenario, tmp_path: Path) -> None:
    done = run("validate", written, "--for", "replay")
    assert done.exit_code == 0, done.output
    folder = Path(shutil.copytree(written, tmp_path / "scenario"))
    still = pivot_of(scenario)
    pivot = folder / "calibration" / "pivot.igs.mha"
    held = {"rotations": still.rotations, "translations_mm": still.translations_mm}
    held = {name: np.repeat(values[:1], len(still), axis=0) for name, values in held.items()}
    write_poses(replace(still, **held), pivot)
    told = errors(run("validate", folder))
    assert told[0].startswith("calibration: pivot calibration: ")
    write_poses(still, pivot)
    (folder / "session.yaml").write_text(run("dump", folder).stdout)
    assert read_session_config(folder / "session.yaml") == read_scenario_session(folder)


def test_what_is_no_configuration_is_told(tmp_path: Path) -> None:
    assert "is not a scenario folder" in errors(run("validate", tmp_path))[0]
    assert "does not exist" in errors(run("dump", tmp_path / "none.yaml"))[0]
