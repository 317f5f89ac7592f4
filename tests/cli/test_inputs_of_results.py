"""Every JSON result says with which versions it was computed and which files were read for it."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import dvf_ig
from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, Landmarks, Points, Rigid, Signal
from dvf_ig.io import write_ecg_csv, write_landmarks, write_model, write_transform


@pytest.fixture
def lab(tmp_path: Path, ball: DvfModel, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a model, points, an ECG, pivot poses, and a transform with landmarks; one works in it."""
    write_model(ball, tmp_path / "ball.npz")
    (tmp_path / "points.csv").write_text("x,y,z\n1,2,9\n3,-4,8\n")
    t_s = np.arange(0.0, 20.0, 0.004)
    peaks = np.exp(-0.5 * (((t_s + 0.4) % 0.8 - 0.4) / 0.012) ** 2)
    write_ecg_csv(Signal(peaks[:, None], 250.0, 0.0, ("II",)), tmp_path / "ecg.csv")
    turns = Rotation.from_rotvec(np.random.default_rng(1).uniform(-0.6, 0.6, (60, 3)))
    places = np.array([10.0, 20.0, 30.0]) - turns.apply([0.0, 0.0, 150.0])
    np.savetxt(tmp_path / "pivot.txt", np.column_stack([places, turns.as_quat()]))
    pose = Rigid.from_rotation_vector([0.1, 0.2, 0.3], [1, 2, 3], "mr", "tracker")
    write_transform(pose, tmp_path / "pose.tfm")
    touched = Landmarks(("a", "b", "c"), Points("tracker", np.diag([50.0, 60.0, 70.0])))
    write_landmarks(touched, tmp_path / "fixed.mrk.json")
    write_landmarks(Landmarks(touched.names, pose.apply(touched.points)), tmp_path / "moving.mrk.json")
    (tmp_path / "never_read.csv").write_text("1,2,3\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def result_of(*arguments: str) -> dict[str, Any]:
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert done.exit_code == 0, done.output
    loaded: dict[str, Any] = json.loads(done.stdout)
    return loaded


COMMANDS = [
    ("force ball.npz --points points.csv --phase 0.2", ["ball.npz", "points.csv"]),
    ("model export ball.npz -o out", ["ball.npz"]),
    ("gate ecg.csv", ["ecg.csv"]),
    ("gate csv:ecg.csv -o gated.json", ["ecg.csv"]),
    ("calibrate pivot pivot.txt -o tip.json", ["pivot.txt"]),
    (
        "evaluate --transform pose.tfm --landmarks fixed.mrk.json moving.mrk.json",
        ["pose.json", "pose.tfm", "fixed.mrk.json", "moving.mrk.json"],
    ),
    ("inspect points.csv", ["points.csv"]),
]


@pytest.mark.parametrize(("line", "read"), COMMANDS, ids=[line for line, _ in COMMANDS])
def test_a_result_lists_what_was_read(lab: Path, line: str, read: list[str]) -> None:
    digests = {name: hashlib.sha256((lab / name).read_bytes()).hexdigest() for name in read}
    sizes = {name: (lab / name).stat().st_size for name in read}
    result = result_of(*line.split())
    assert {one["file"]: one["sha256"] for one in result["inputs"]} == digests
    assert {one["file"]: one["bytes"] for one in result["inputs"]} == sizes
    assert result["versions"]["dvf_ig"] == dvf_ig.__version__
    if "-o" in line and line.endswith(".json"):
        written = json.loads((lab / line.split()[-1]).read_text())
        assert (written["inputs"], written["versions"]) == (result["inputs"], result["versions"])


def test_no_path_of_the_machine_is_told(lab: Path) -> None:
    result = result_of("force", str(lab / "ball.npz"), "--points", str(lab / "points.csv"), "--phase", "0.2")
    assert [one["file"] for one in result["inputs"]] == ["ball.npz", "points.csv"]
    assert str(lab) not in json.dumps(result)


def test_one_command_lists_nothing_of_another(lab: Path) -> None:
    result_of("gate", "ecg.csv")
    result = result_of("force", "ball.npz", "--points", "points.csv", "--phase", "0.2")
    assert [one["file"] for one in result["inputs"]] == ["ball.npz", "points.csv"]


def test_what_reads_in_other_processes_lists_nothing() -> None:
    assert not {"versions", "inputs"} & result_of("doctor").keys()
