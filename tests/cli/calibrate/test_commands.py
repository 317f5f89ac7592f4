"""`dvf-ig calibrate`: fixed JSON names, PLUS XML, exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.io import read_coordinate_definitions


def table(path: Path, half_angle_deg: float) -> Path:
    """A pivot recording as rows x y z qx qy qz qw."""
    rng = np.random.default_rng(0)
    rotations = Rotation.from_rotvec(rng.uniform(-1, 1, (80, 3)) * np.radians(half_angle_deg))
    shifts = (
        np.array([80.0, -40, -900]) - rotations.apply([3.0, -12, 150]) + 0.1 * rng.standard_normal((80, 3))
    )
    np.savetxt(path, np.column_stack([shifts, rotations.as_quat()]))
    return path


def test_pivot_json_and_xml(tmp_path: Path) -> None:
    out = tmp_path / "tip.json"
    poses = table(tmp_path / "poses.txt", 35.0)
    done = CliRunner().invoke(app, ["calibrate", "pivot", str(poses), "--json", "-o", str(out)])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    names = {"tip_mm", "pivot_mm", "rms_3d_mm", "rms_per_coordinate_mm", "inliers", "poses", "span_deg"}
    assert set(result) >= names
    assert np.allclose(result["tip_mm"], [3, -12, 150], atol=0.2)
    saved = json.loads(out.read_text())
    assert len(saved["inputs"][0]["sha256"]) == 64
    matrix = read_coordinate_definitions(out.with_suffix(".xml"))["tool_from_tool_tip"]
    assert matrix[:3, 3].tolist() == result["tip_mm"]


def test_a_tool_that_does_not_turn_exits_7_and_writes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "tip.json"
    done = CliRunner().invoke(
        app, ["calibrate", "pivot", str(table(tmp_path / "p.txt", 0.0)), "-o", str(out)]
    )
    assert done.exit_code == 7
    assert "tilt the tool" in done.output
    assert not out.exists()


def test_a_missing_file_exits_3(tmp_path: Path) -> None:
    assert CliRunner().invoke(app, ["calibrate", "pivot", str(tmp_path / "none.txt")]).exit_code == 3


def test_probe_and_latency_on_real_files(data_dir: Path, tmp_path: Path) -> None:
    folder = data_dir / "plus-fcal20-nwire"
    arguments = ["calibrate", "probe", str(folder / "fCal_Test_Calibration_3NWires_fCal2.0.igs.mha")]
    arguments += ["--device-set", str(folder / "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml"), "--json"]
    arguments += ["--points", str(folder / "FreehandCalibration3NWires_fCal2.0.results.xml")]
    arguments += ["--validate", str(folder / "fCal_Test_Validation_3NWires_fCal2.0.igs.mha")]
    done = CliRunner().invoke(app, arguments)
    result = json.loads(done.stdout)
    assert result["validation"]["mean95_mm"] <= 0.55
    assert result["validation"]["frames_used"] == 103
    assert np.array(result["sensor_from_image"]).shape == (4, 4)
    folder = data_dir / "plus-temporal-watertank"
    arguments = ["calibrate", "latency", "--json"]
    arguments += [str(folder / "WaterTankBottomTranslationTrackerBuffer-trimmed.igs.mha")]
    arguments += [str(folder / "WaterTankBottomTranslationVideoBuffer.igs.mha")]
    arguments += ["--line-table", str(folder / "LineSegmentationResultsBaseline.xml")]
    lag = json.loads(CliRunner().invoke(app, arguments).stdout)
    assert lag["lag_s"] == pytest.approx(-0.0648, abs=0.005)
    assert len(lag["interval_s"]) == 2
