"""Calibrations that a quality gate refuses: printed, drawn, written, marked; read back knowingly only."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app
from dvf_ig.core import FloatArray, PoseStream, QualityGateError, TrackedSequence, UnreadableFileError
from dvf_ig.io import (
    read_coordinate_definitions,
    read_hand_eye,
    read_lag,
    read_landmark_map,
    read_probe,
    read_tip,
    write_sequence,
)

TIP_MM = np.array([3.0, -12.0, 150.0])


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def pivot_table(path: Path, noise_mm: float, half_angle_deg: float = 35.0) -> Path:
    """Rows x y z qx qy qz qw of a tool that turns about a divot."""
    rng = np.random.default_rng(0)
    rotations = Rotation.from_rotvec(rng.uniform(-1, 1, (300, 3)) * np.radians(half_angle_deg))
    shifts = np.array([80.0, -40, -900]) - rotations.apply(TIP_MM)
    shifts += noise_mm * rng.standard_normal((300, 3))
    np.savetxt(path, np.column_stack([shifts, rotations.as_quat()]))
    return path


@pytest.fixture
def loose(tmp_path: Path) -> Path:
    """A recording of 2.17 mm RMS, over the gate of 2 mm."""
    return pivot_table(tmp_path / "poses.txt", 2.17 / np.sqrt(3))


def test_a_pivot_over_the_gate_gives_tip_residual_picture_and_json(loose: Path, tmp_path: Path) -> None:
    out = tmp_path / "tip.json"
    done = run("calibrate", "pivot", loose, "-o", out, "--json")
    assert done.exit_code == 7
    result = json.loads(done.stdout)
    assert result["rms_3d_mm"] == pytest.approx(2.17, abs=0.1)
    assert np.abs(np.array(result["tip_mm"]) - TIP_MM).max() < 1.0
    assert result["refused"] is True
    assert "the gate of 2 mm" in result["refused_because"][0]
    saved = json.loads(out.read_text())
    assert saved["refused"] is True
    assert saved["tip_mm"] == result["tip_mm"]
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert not out.with_suffix(".xml").exists(), "PLUS XML cannot say that it is refused"
    assert "must not be used" in done.stderr
    shown = run("calibrate", "pivot", loose)
    assert shown.exit_code == 7
    assert "REFUSED" in shown.stdout
    assert "tip " in shown.stdout


def test_the_gate_is_moved_knowingly_and_the_file_says_so(loose: Path, tmp_path: Path) -> None:
    out = tmp_path / "tip.json"
    done = run("calibrate", "pivot", loose, "-o", out, "--max-residual-mm", 3)
    assert done.exit_code == 0, done.output
    saved = json.loads(out.read_text())
    assert (saved["refused"], saved["max_residual_mm"]) == (False, 3.0)
    assert out.with_suffix(".xml").is_file()
    assert run("calibrate", "pivot", loose, "--max-residual-mm", 1).exit_code == 7


def test_a_refused_file_is_read_only_when_asked_for(loose: Path, tmp_path: Path) -> None:
    out = tmp_path / "tip.json"
    run("calibrate", "pivot", loose, "-o", out)
    with pytest.raises(QualityGateError, match=r"refused calibration: pivot residual .* calibrate again"):
        read_tip(out)
    assert np.abs(read_tip(out, allow_refused=True).xyz_mm[0] - TIP_MM).max() < 1.0


def test_small_rotations_give_a_tip_that_is_refused(tmp_path: Path) -> None:
    poses = pivot_table(tmp_path / "p.txt", 0.05, half_angle_deg=4.0)
    done = run("calibrate", "pivot", poses, "--json")
    assert done.exit_code == 7
    result = json.loads(done.stdout)
    assert "tilt the tool" in result["refused_because"][0]
    assert np.abs(np.array(result["tip_mm"]) - TIP_MM).max() < 3.0


def test_a_tip_is_read_back_from_json_and_xml(tmp_path: Path) -> None:
    out = tmp_path / "tip.json"
    done = run("calibrate", "pivot", pivot_table(tmp_path / "p.txt", 0.1), "-o", out, "--json")
    tip_mm = json.loads(done.stdout)["tip_mm"]
    for path in (out, out.with_suffix(".xml")):
        read = read_tip(path)
        assert read.frame == "tool"
        assert np.abs(read.xyz_mm[0] - tip_mm).max() < 1e-9
    with pytest.raises(UnreadableFileError, match="is the tip of 'tool'; needed that of 'needle'"):
        read_tip(out, tool="needle")
    with pytest.raises(UnreadableFileError, match=r"of kind 'tip'; give what dvf-ig calibrate latency -o"):
        read_lag(out)
    with pytest.raises(UnreadableFileError, match="is not a tool tip; give what dvf-ig calibrate pivot"):
        read_tip(written(tmp_path / "x.json", {"tip_mm": [0, 0, 0]}))


def test_wrong_values_of_a_calibration_file_are_named(tmp_path: Path) -> None:
    verdict = {"refused": False, "refused_because": []}
    path = written(tmp_path / "lag.json", {"kind": "latency", "lag_s": "soon", **verdict})
    with pytest.raises(UnreadableFileError, match=r"lag\.json: lag_s: "):
        read_lag(path)
    with pytest.raises(UnreadableFileError, match=r"refused: "):
        read_lag(written(path, {"kind": "latency", "lag_s": 0.1}))
    shear = {"kind": "probe", "sensor_frame": "probe", **verdict}
    crooked = [[0.1, 0.1, 0, 0], [0.0, 0.1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    with pytest.raises(UnreadableFileError, match="off orthogonal"):
        read_probe(written(path, {**shear, "sensor_from_image": crooked}))


def written(path: Path, document: dict[str, Any]) -> Path:
    path.write_text(json.dumps(document))
    return path


def streams(folder: Path) -> tuple[Path, Path, FloatArray]:
    """A hand that tilts in all directions, what its camera sees of a still target, hand_from_camera."""
    rng = np.random.default_rng(2)
    count = 40
    base_from_hand, base_from_target, hand_from_camera = (
        np.tile(np.eye(4), (count, 1, 1)),
        np.eye(4),
        np.eye(4),
    )
    base_from_hand[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (count, 3))).as_matrix()
    base_from_hand[:, :3, 3] = rng.uniform(-100, 100, (count, 3))
    base_from_target[:3, 3] = (0.0, 50, 500)
    hand_from_camera[:3, :3] = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    hand_from_camera[:3, 3] = (20.0, -10, 60)
    camera_from_target = np.linalg.inv(base_from_hand @ hand_from_camera) @ base_from_target
    paths = []
    for name, target, source, poses in (
        ("robot", "base", "hand", base_from_hand),
        ("camera", "camera", "target", camera_from_target),
    ):
        stream = PoseStream(
            target, source, np.arange(count) / 10, poses[:, :3, :3], poses[:, :3, 3], np.ones(count, np.bool_)
        )
        valid = np.ones(count, np.bool_)
        paths.append(folder / f"{name}.igs.mha")
        write_sequence(TrackedSequence(stream.t_s, None, valid, {stream.name: stream}), paths[-1])
    return paths[0], paths[1], hand_from_camera


def test_hand_eye_is_read_back_from_json_and_xml(tmp_path: Path) -> None:
    robot, camera, hand_from_camera = streams(tmp_path)
    out = tmp_path / "hand.json"
    done = run("calibrate", "hand-eye", robot, camera, "-o", out, "--json")
    assert done.exit_code == 0, done.output
    matrix = np.array(json.loads(done.stdout)["hand_from_camera"])
    for path in (out, out.with_suffix(".xml")):
        read = read_hand_eye(path)
        assert read.name == "hand_from_camera"
        assert np.abs(read.matrix - matrix).max() < 1e-9
        assert np.abs(read.matrix - hand_from_camera).max() < 1e-3


def test_probe_lag_and_landmarks_of_real_files_are_read_back(data_dir: Path, tmp_path: Path) -> None:
    folder, out = data_dir / "plus-fcal20-nwire", tmp_path / "probe.json"
    device = folder / "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml"
    arguments = [folder / "fCal_Test_Calibration_3NWires_fCal2.0.igs.mha", "--device-set", device]
    arguments += ["--points", folder / "FreehandCalibration3NWires_fCal2.0.results.xml", "-o", out]
    done = run("calibrate", "probe", *arguments, "--json")
    assert done.exit_code == 0, done.output
    matrix = np.array(json.loads(done.stdout)["sensor_from_image"])
    for path in (out, out.with_suffix(".xml")):
        assert np.abs(read_probe(path).matrix - matrix).max() < 1e-9
    strict = run("calibrate", "probe", *arguments, "--max-residual-mm", 0.01, "--json")
    assert strict.exit_code == 7
    assert "middle wires miss by" in json.loads(strict.stdout)["refused_because"][0]
    with pytest.raises(QualityGateError, match="middle wires miss"):
        read_probe(out)
    assert np.abs(read_probe(out, allow_refused=True).matrix - matrix).max() < 1.0
    folder, lag = data_dir / "plus-temporal-watertank", tmp_path / "lag.json"
    arguments = [folder / "WaterTankBottomTranslationTrackerBuffer-trimmed.igs.mha"]
    arguments += [folder / "WaterTankBottomTranslationVideoBuffer.igs.mha"]
    arguments += ["--line-table", folder / "LineSegmentationResultsBaseline.xml", "-o", lag, "--json"]
    assert read_lag_of(run("calibrate", "latency", *arguments)) == read_lag(lag)


def read_lag_of(done: Result) -> float:
    assert done.exit_code == 0, done.output
    return float(json.loads(done.stdout)["lag_s"])


def test_landmark_map_is_read_back(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.2, 0.1, -0.4]).as_matrix()
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, (1.0, 2, 3)
    document = {"kind": "landmarks", "target_from_source": matrix.tolist(), "target": "reference"}
    verdict = {"source": "phantom", "refused": False, "refused_because": []}
    read = read_landmark_map(written(tmp_path / "phantom.json", {**document, **verdict}))
    assert read.name == "reference_from_phantom"
    assert np.abs(read.matrix - matrix).max() < 1e-9


def test_files_beside_the_output_never_replace_a_users_own(tmp_path: Path) -> None:
    poses = pivot_table(tmp_path / "poses.txt", 0.1)
    out = tmp_path / "stylus.json"
    own = tmp_path / "stylus.xml"
    own.write_text("<PlusConfiguration>the lab's own</PlusConfiguration>")
    done = run("calibrate", "pivot", poses, "-o", out)
    assert done.exit_code == 4
    assert f"cannot write {own}: a file of that name exists" in done.output
    assert "the lab's own" in own.read_text()
    assert not out.exists(), "nothing half-written"
    own.unlink()
    for _ in range(2):  # our own files are replaced
        assert run("calibrate", "pivot", poses, "-o", out).exit_code == 0
    assert "tool_from_tool_tip" in read_coordinate_definitions(own)
    out.with_suffix(".png").write_bytes(b"a drawing of the user's")
    assert run("calibrate", "pivot", poses, "-o", out).exit_code == 4
    assert out.with_suffix(".png").read_bytes() == b"a drawing of the user's"
