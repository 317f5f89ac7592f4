"""`dvf-ig export`: a run names its recording; what is written opens elsewhere, and a log replays."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import Scenario


def test_a_scene_shows_tracked_targets_on_those_of_the_mr(
    run: Path, scenario: Scenario, tmp_path: Path
) -> None:
    """By SimpleITK and JSON: what the tracker would say of the targets, under the transform of the scene."""
    done = CliRunner().invoke(app, ["export", "slicer", str(run), "-o", str(tmp_path / "scene"), "--json"])
    assert done.exit_code == 0, done.output
    files = json.loads(done.stdout)["files"]
    assert {"scene.mrml", "README.md", "TrackerToRas.seq.mha", "ultrasound.seq.nrrd"} <= set(files)
    for name, frame in files.items():
        assert f"wrote {tmp_path / 'scene' / name}  (frame {frame})" in done.stderr
    truth = scenario.truth
    assert truth is not None
    (markup,) = json.loads((tmp_path / "scene" / "targets.mrk.json").read_text())["markups"]
    shown = [point["position"] for point in markup["controlPoints"]]
    np.testing.assert_allclose(shown, truth.targets.points.xyz_mm)
    assert "95 %" in markup["controlPoints"][0]["description"]
    tracker = SimpleITK.ReadTransform(str(tmp_path / "scene" / "TrackerToRas.tfm")).GetInverse()
    tracked = truth.mr_from_tracker_at(0.0).inverse().apply_array(truth.targets.points.xyz_mm)
    device = tracked * (-1, -1, 1)  # device coordinates count as RAS
    found = [tracker.TransformPoint(point) for point in device.tolist()]
    errors_mm = np.linalg.norm(found - truth.targets.points.xyz_mm, axis=1)
    assert errors_mm.max() < 5.0  # the registration's error


def test_a_log_holds_the_recording(run: Path, scenario: Scenario, tmp_path: Path) -> None:
    """`test_session_log` compares its events to the last bit."""
    pytest.importorskip("rosbags", reason="session logs need rosbags")
    from dvf_ig.intake.session_log.read import read_session_log

    log = tmp_path / "session.mcap"
    done = CliRunner().invoke(app, ["export", "mcap", str(run), "-o", str(log), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["messages"] > 17_000
    back = read_session_log(log).scenario
    np.testing.assert_array_equal(back.ultrasound.images, scenario.ultrasound.images)
    assert len(back.ecg) == len(scenario.ecg)


def test_another_recording_is_refused(run: Path, written: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(written, other)
    text = (other / "landmarks_mr.mrk.json").read_text()
    (other / "landmarks_mr.mrk.json").write_text(text + "\n")
    out = ["-o", str(tmp_path / "scene")]
    done = CliRunner().invoke(app, ["export", "slicer", str(run), "--recording", str(other), *out])
    assert done.exit_code == 3
    assert "landmarks_mr.mrk.json differs" in done.stderr
    moved = CliRunner().invoke(app, ["export", "slicer", str(run), "--recording", str(tmp_path / "no"), *out])
    assert moved.exit_code == 2
    assert not (tmp_path / "scene").exists()


def test_a_folder_that_names_no_recording(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["export", "slicer", str(tmp_path), "-o", str(tmp_path / "scene")])
    assert done.exit_code == 2
    assert "--recording" in done.stderr
    wrong = CliRunner().invoke(app, ["export", "mcap", str(tmp_path), "-o", "log.bag"])
    assert wrong.exit_code == 2
