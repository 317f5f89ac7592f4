"""Real recordings through the commands that a user would type: calibrations above all.

Cines are in `model/test_real_cines.py`, the ECG in `test_lab_files.py`, labels of a whole heart in the tests
of `synth us`, calibrations within their gates in `calibrate/`.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.cli.synth.spec import read_spec, scenario_spec
from dvf_ig.core import NWireRecording
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.intake.session import read_session
from dvf_ig.io import read_image_map

COLUMNS, ROWS = 820, 616
DEVICE_SET = "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml"
SWEEP = "fCal_Test_Calibration_3NWires_fCal2.0.igs.mha"
RESULTS = "FreehandCalibration3NWires_fCal2.0.results.xml"


def run(*words: object, code: int = 0) -> dict[str, Any]:
    done = CliRunner().invoke(app, [*map(str, words), "--json"])
    assert done.exit_code == code, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def fcal(data_dir: Path) -> Path:
    return data_dir / "plus-fcal20-nwire"


def test_a_scenario_with_the_calibration_of_the_real_probe(fcal: Path, tmp_path: Path) -> None:
    """The file reaches the world; the YAML that describes the scenario makes the same one again."""
    options = ["--probe-calibration", fcal / RESULTS, "--image-px", COLUMNS, ROWS, "--seed", 101]
    words = ["synth", "scenario", *options, "--print-spec"]
    first = CliRunner().invoke(app, [str(word) for word in words])
    assert first.exit_code == 0, first.output
    path = tmp_path / "spec.yaml"
    path.write_text(first.stdout)
    again = CliRunner().invoke(app, ["synth", "scenario", "--spec", str(path), "--print-spec"])
    assert again.stdout == first.stdout
    spec = scenario_spec(read_spec(path))
    assert spec.image is not None
    assert (spec.seed, spec.image.columns, spec.image.rows) == (101, COLUMNS, ROWS)
    assert np.array_equal(spec.image.probe_from_image.matrix, read_image_map(fcal / RESULTS).matrix)


def test_other_scenarios_are_described_as_before() -> None:
    done = CliRunner().invoke(app, ["synth", "scenario", "--print-spec"])
    assert "probe_calibration" not in done.stdout
    assert "image_px" not in done.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--probe-calibration", RESULTS], "--image-px"),
        (["--image-px", "820", "616"], "--probe-calibration"),
        (["--probe-calibration", RESULTS, "--image-px", "82", "80"], "check that the size in pixels belongs"),
        (
            ["--probe-calibration", DEVICE_SET, "--image-px", "820", "616"],
            "has no transform probe_from_image",
        ),
    ],
)
def test_half_a_probe_is_refused(fcal: Path, tmp_path: Path, options: list[str], words: str) -> None:
    given = [str(fcal / word) if word.endswith(".xml") else word for word in options]
    done = CliRunner().invoke(app, ["synth", "scenario", *given, "-o", str(tmp_path / "out")])
    assert done.exit_code == 3
    assert words in " ".join(done.output.split())
    assert not (tmp_path / "out").exists()


def test_the_real_sweep_calibrates_a_session(fcal: Path, written: Path, tmp_path: Path) -> None:
    """Named in a SESSION.yaml it gives a map that is 0.2 mm from the published one at the image's corners."""
    probe = {"phantom": "nwire", "file": fcal / SWEEP, "device_set": fcal / DEVICE_SET}
    probe["points"] = fcal / RESULTS
    preop = {"labels": "labels.nrrd", "timing": "timing.json", "mr": "mr.nrrd"}
    document = {
        "schema": "dvf_ig.session/1",
        "preop": {key: str(written / "preop" / name) for key, name in preop.items()},
        "ultrasound": str(written / "ultrasound.igs.mha"),
        "ecg": f"csv:{written / 'ecg.csv'}",
        "calibration": {"probe": {key: str(value) for key, value in probe.items()}, "latency": 0.03},
    }
    (tmp_path / "SESSION.yaml").write_text(yaml.safe_dump(document))
    session = read_session(tmp_path / "SESSION.yaml").scenario
    assert isinstance(session.probe, NWireRecording)
    assert len(session.probe.points_px) == 190
    found, published = calibrate(session, 0).ultrasound.probe_from_image, read_image_map(fcal / RESULTS)
    corners = np.array([[x, y] for x in (0.0, COLUMNS - 1.0) for y in (0.0, ROWS - 1.0)])
    apart = found.apply_pixels(corners).xyz_mm - published.apply_pixels(corners).xyz_mm
    assert np.linalg.norm(apart, axis=1).max() == pytest.approx(0.205, abs=0.01)


def test_a_third_of_the_poses_off_is_found_and_the_tip_accepted(data_dir: Path, tmp_path: Path) -> None:
    folder, out = data_dir / "lsqrrecipes", tmp_path / "tip.json"
    found = run("calibrate", "pivot", folder / "pivotCalibrationDataWithOutliers.txt", "-o", out)
    clean = run("calibrate", "pivot", folder / "pivotCalibrationData.txt")
    assert (found["refused"], found["poses"]) == (False, 480)
    assert 320 < found["inliers"] < 345
    assert np.linalg.norm(np.subtract(found["tip_mm"], clean["tip_mm"])) < 0.4
    assert out.with_suffix(".xml").is_file()


@pytest.mark.usefixtures("drawn")
def test_a_recording_over_the_gate_still_shows_what_it_gives(data_dir: Path, tmp_path: Path) -> None:
    """Tip, residual, picture and JSON, and exit 7; the gate is moved knowingly."""
    poses, out = data_dir / "lsqrrecipes" / "pivotCalibrationData.txt", tmp_path / "tip.json"
    found = run("calibrate", "pivot", poses, "--max-residual-mm", 0.4, "-o", out, code=7)
    assert "is 0.51 mm RMS, above the gate of 0.4 mm" in found["refused_because"][0]
    held = json.loads(out.read_text())
    assert (held["tip_mm"], held["refused"]) == (found["tip_mm"], True)
    assert out.with_suffix(".png").stat().st_size > 10_000
    assert not out.with_suffix(".xml").exists(), "PLUS XML cannot mark a calibration as refused"
    accepted = run("calibrate", "pivot", poses, "-o", out)
    assert accepted["tip_mm"] == found["tip_mm"]
    assert out.with_suffix(".xml").is_file()


def test_a_probe_swept_by_hand_is_no_pivot(fcal: Path, tmp_path: Path) -> None:
    """Every reason is told: it hardly turns, and it does not rest at a point."""
    poses, out = fcal / "fCal_Test_Validation_3NWires_fCal2.0.igs.mha", tmp_path / "tip.json"
    found = run("calibrate", "pivot", poses, "--tool", "probe", "-o", out, code=7)
    turned, residual = found["refused_because"]
    assert "rotates by 4.9° only" in turned
    assert "2.13 mm RMS, above the gate of 2 mm" in residual
    assert found["rms_3d_mm"] == pytest.approx(2.13, abs=0.05)
    assert len(json.loads(out.read_text())["tip_mm"]) == 3
    assert out.with_suffix(".png").is_file()


def test_a_stylus_that_touches_landmarks_is_no_pivot(data_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "tip.json"
    poses = data_dir / "plus-phantom-landmarks" / "EightLandmarkPointsTrackedForPhantomRegistration.igs.mha"
    found = run("calibrate", "pivot", poses, "-o", out, code=7)
    assert "of 1000 poses of reference_from_stylus rotate about one point" in found["refused_because"][0]
    assert found["inliers"] < 100
    assert out.with_suffix(".png").is_file()


INSPECTED = [
    ("acdc-cine/patient002/cine_4d.nii.gz", "image", {"phases": 30}),
    ("acdc-cine/patient002/ed_labels.nii.gz", "image", {"labels": [0, 1, 2, 3]}),
    ("plus-phantom-landmarks/PhantomRegistrationLandmarkDetection.results.xml", "PLUS", {"landmarks": 8}),
    (
        "plus-nwire-segmentation/PlusDeviceSet_iCal_CalibrationOnly_VLCUS_FrameGrabber.xml",
        "PLUS",
        {"landmarks": 1},
    ),
    ("plus-scanconv/UltrasonixCurvilinearBrightnessData.igs.mha", "tracked sequence", {}),
]


@pytest.mark.parametrize(("name", "kind", "facts"), INSPECTED, ids=[name for name, _, _ in INSPECTED])
def test_what_inspect_says_of_the_other_folders(
    data_dir: Path, name: str, kind: str, facts: dict[str, Any]
) -> None:
    found = run("inspect", data_dir / name)
    assert kind in found["kind"]
    assert {key: found[key] for key in facts} == facts
