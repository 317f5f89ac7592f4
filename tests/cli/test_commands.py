"""The commands as a user types them: help without heavy imports, doctor, register, evaluate, replay."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import dvf_ig
from dvf_ig.cli.main import app
from dvf_ig.core import Landmarks, Points, Rigid, Scenario
from dvf_ig.io import read_transform, write_landmarks, write_scenario, write_transform
from dvf_ig.registration import target_errors_mm


def run(*arguments: str) -> dict[str, object]:
    """The JSON that a successful command prints."""
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    loaded: dict[str, object] = json.loads(result.stdout)
    return loaded


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from typer.testing import CliRunner; from dvf_ig.cli.main import app;"
        "r = CliRunner().invoke(app, ['--help']); assert r.exit_code == 0;"
        "heavy = {'numba', 'SimpleITK', 'open3d', 'cv2', 'matplotlib'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_module_and_version() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dvf_ig", "--version"], check=True, capture_output=True, text=True
    )
    assert done.stdout.strip() == f"dvf-ig {dvf_ig.__version__}"


def test_doctor_names_what_is_needed() -> None:
    payload = run("doctor")
    assert payload["ok"] is True
    names = {check["what"] for check in payload["checks"]}  # type: ignore[attr-defined]
    assert {"package numba", "package SimpleITK", "system library libusb-1.0-0"} <= names


def test_register_writes_a_transform_that_evaluate_reads(scenario: Scenario, tmp_path: Path) -> None:
    write_scenario(scenario, tmp_path / "scenario")
    out = tmp_path / "registered"
    payload = run("register", str(tmp_path / "scenario"), "-o", str(out))
    assert payload["stop"] == "CONVERGED"
    assert np.shape(payload["covariance"]) == (6, 6)
    assert {"success_probability", "seconds", "threads", "seed"} <= set(payload)
    estimate = read_transform(out / "mr_from_tracker.tfm")
    np.testing.assert_allclose(estimate.matrix, payload["mr_from_tracker"], atol=1e-9)
    assert scenario.truth is not None
    truth = scenario.truth.mr_from_tracker_at(0.0)
    assert np.median(target_errors_mm(estimate, truth, scenario.truth.targets.points)) < 2.0

    write_transform(truth, tmp_path / "truth.tfm")
    touched = truth.inverse().apply(scenario.truth.targets.points)
    write_landmarks(Landmarks(scenario.truth.targets.names, touched), tmp_path / "fixed.mrk.json")
    write_landmarks(scenario.truth.targets, tmp_path / "moving.mrk.json")
    against_truth = run(
        "evaluate",
        "--transform",
        str(out),
        "--landmarks",
        str(tmp_path / "fixed.mrk.json"),
        "--truth",
        str(tmp_path / "truth.tfm"),
    )
    against_points = run(
        "evaluate",
        "--transform",
        str(out),
        "--landmarks",
        str(tmp_path / "fixed.mrk.json"),
        str(tmp_path / "moving.mrk.json"),
    )
    assert against_truth["tre_mm"] == pytest.approx(against_points["tre_mm"], abs=1e-6)
    assert against_points["rotation_deg"] is None
    assert against_truth["rotation_deg"] == pytest.approx(
        np.degrees((estimate @ truth.inverse()).angle_rad), abs=1e-6
    )


def test_evaluate_of_a_known_shift(tmp_path: Path) -> None:
    truth = Rigid.from_rotation_vector([0.1, 0.2, 0.3], [10, 20, 30], "mr", "tracker")
    shifted = Rigid("mr", "tracker", truth.rotation, truth.translation_mm + np.array([3.0, 0.0, 4.0]))
    write_transform(shifted, tmp_path / "estimate.tfm")
    write_transform(truth, tmp_path / "truth.tfm")
    points = Landmarks(("a", "b"), Points("tracker", np.array([[0.0, 0, 0], [50, 60, 70]])))
    write_landmarks(points, tmp_path / "points.mrk.json")
    result = run(
        "evaluate",
        "--transform",
        str(tmp_path / "estimate.tfm"),
        "--landmarks",
        str(tmp_path / "points.mrk.json"),
        "--truth",
        str(tmp_path / "truth.tfm"),
    )
    assert result["tre_mm"]["max"] == pytest.approx(5.0, abs=1e-6)  # type: ignore[index]
    np.testing.assert_allclose(result["translation_mm"], [3, 0, 4], atol=1e-6)
