"""Points touched on the heart as the only start of a registration, and as a check beside another start."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from known_patient import registration
from toy_lab import SESSION, sweep, write_lab
from toy_touched import beating_model, grid_targets, heart_center_mm, random_pose, touched_points
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, FloatArray, Rigid, TrackedSequence
from dvf_ig.io import write_sequence, write_transform
from dvf_ig.registration import target_errors_mm
from dvf_ig.replay.page.registration_page import ShownInput

POSE = random_pose(np.random.default_rng(4))


@pytest.fixture(scope="module")
def heart() -> DvfModel:
    return beating_model()


@pytest.fixture(scope="module")
def files(heart: DvfModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lab's files, with 60 points of 1 mm noise touched at end-diastole, its start at the true pose."""
    folder = tmp_path_factory.mktemp("lab")
    write_lab(folder, heart)
    write_transform(POSE, folder / "start.tfm")
    write_sequence(sweep_at(POSE.inverse().translation_mm), folder / "sweep.igs.mha")
    rng = np.random.default_rng(11)
    found = touched_points(heart, POSE, rng, count=200, outlier_share=0.0, facing=-1.0)
    at_diastole = found.model_phase == heart.timing.fractions[heart.ed_phase]
    touched_mm = found.points.xyz_mm[at_diastole][:60]
    write_points(folder / "touched.csv", touched_mm)
    write_points(folder / "moved.csv", touched_mm + np.array([0.0, 0.0, 15.0]))
    return folder


def sweep_at(place_mm: FloatArray) -> TrackedSequence:
    """The lab's sweep with its probe near a place, frame tracker."""
    recorded = sweep()
    probe = recorded.poses["tracker_from_probe"]
    there = replace(probe, translations_mm=probe.translations_mm - probe.translations_mm[0] + place_mm)
    return replace(recorded, poses={there.name: there})


def write_points(path: Path, xyz_mm: FloatArray) -> None:
    np.savetxt(path, xyz_mm, delimiter=",", header="x,y,z", comments="")


@pytest.fixture
def lab(files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory; the ultrasound says that every start is right."""
    monkeypatch.chdir(files)
    monkeypatch.setattr("dvf_ig.replay.registration.build_heart", shape_alone)
    monkeypatch.setattr(
        "dvf_ig.replay.registration.gate_recording", lambda *_, **__: SimpleNamespace(enough=True)
    )
    monkeypatch.setattr(
        "dvf_ig.replay.registration.register_frames",
        lambda recording, _frames, start, **_: registration(start, recording.heart.center_mm),
    )
    monkeypatch.setattr(
        "dvf_ig.replay.page.registration_inputs.frames_shown",
        lambda *_: ShownInput("toy", "patient toy", "tracker", "mr", "MR", "", [], []),
    )
    return files


def shape_alone(_preop: object, model: DvfModel, **_: object) -> Any:
    """What touched points need of a heart."""
    return SimpleNamespace(model=model, center_mm=heart_center_mm(model))


def register(start: dict[str, Any], *options: str, model: str = "heart.npz") -> Result:
    document = SESSION | {"start": start, "preop": {"model": model}}
    Path("session.yaml").write_text(yaml.safe_dump(document))
    return CliRunner().invoke(app, ["register", "session.yaml", "-o", "out", *options])


def error_mm(found: list[list[float]], heart: DvfModel) -> float:
    pose = Rigid("mr", "tracker", np.array(found)[:3, :3], np.array(found)[:3, 3])
    return float(target_errors_mm(pose, POSE, grid_targets(heart)).mean())


def test_touched_points_alone_start_a_registration(lab: Path, heart: DvfModel) -> None:
    done = register({"touched": "touched.csv"}, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert error_mm(found["start"], heart) < 2.0
    assert found["surface_points"]["points"] == 60
    assert found["surface_points"]["agrees"]
    assert 0.2 < found["surface_points"]["median_mm"] < found["surface_points"]["limit_mm"] < 3.0


def test_touched_points_check_another_start(lab: Path) -> None:
    start = {"transform": "start.tfm", "touched": "touched.csv"}
    named = register(start)
    done = register({**start, "touched_phase": 0.0})
    assert done.exit_code == 0, done.output
    assert named.stdout == done.stdout
    assert "touched surface" in done.stdout
    assert "agrees with the pose)" in done.stdout


def test_points_that_lie_elsewhere_refuse_the_pose_with_all_its_evidence(lab: Path) -> None:
    done = register({"transform": "start.tfm", "touched": "moved.csv"})
    assert done.exit_code == 7
    (told,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert "must not be used: independent checks of the pose disagree" in told
    assert "mm from the surface (median of 60; needed at most" in told
    assert "the pose or the touched points are wrong" in told
    written = json.loads((lab / "out/result.json").read_text())
    assert written["stop"] == "DISAGREEMENT"
    assert not written["surface_points"]["agrees"]
    assert "touched surface" in done.stdout
    assert "Touched surface" in (lab / "out/report.html").read_text()
    assert not (lab / "out/mr_from_tracker.xml").exists()


def test_another_phase_lies_elsewhere(lab: Path) -> None:
    """End-systole's surface is up to a tenth smaller."""
    found = []
    for place in (0.0, 0.35):
        start = {"transform": "start.tfm", "touched": "touched.csv", "touched_phase": place}
        done = register(start, "--json")
        found.append(json.loads(done.stdout)["surface_points"]["median_mm"])
    assert found[1] > found[0] + 1.0


def test_points_that_leave_the_pose_open_are_no_start(lab: Path, tmp_path: Path) -> None:
    """Of a ball."""
    ball = beating_model(bumps=0.0)
    found = touched_points(ball, POSE, np.random.default_rng(3), count=60, outlier_share=0.0, facing=-1.0)
    write_lab(tmp_path, ball)
    write_points(tmp_path / "ball.csv", found.points.xyz_mm)
    done = register({"touched": f"{tmp_path}/ball.csv"}, model=f"{tmp_path}/heart.npz")
    assert done.exit_code == 7
    assert "error: start: no start: the touched points leave the pose undetermined" in done.stderr
