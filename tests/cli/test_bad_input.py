"""Bad input ends with its exit code and one clear sentence, and leaves nothing half-written."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from recorded import pivot_of, tool_of
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import Scenario, Signal
from dvf_ig.intake import write_scenario
from dvf_ig.io import write_ecg_csv, write_model, write_poses
from dvf_ig.replay import Replay


@pytest.fixture
def folder(brief: Scenario, tmp_path: Path) -> Path:
    """The scenario on disk with few images, for a test to damage."""
    write_scenario(brief, tmp_path / "scenario")
    return tmp_path / "scenario"


def fails(arguments: list[str], code: int, *words: str) -> None:
    """The command exits with `code` after one sentence that holds every word."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == code, result.output
    message = result.stderr.strip()
    assert message.startswith("error: ")
    assert "\n" not in message
    assert "Traceback" not in result.output
    for word in words:
        assert word in message


def replay_fails(folder: Path, code: int, *words: str, extra: tuple[str, ...] = ()) -> None:
    run = folder.parent / "run"
    fails(["replay", str(folder), "-o", str(run), *extra], code, *words)
    assert not run.exists()


def test_truncated_ultrasound(folder: Path) -> None:
    path = folder / "ultrasound.igs.mha"
    path.write_bytes(path.read_bytes()[:-100_000])
    replay_fails(folder, 3, "ultrasound.igs.mha")


def test_ecg_without_beats(folder: Path, scenario: Scenario) -> None:
    assert isinstance(scenario.ecg, Signal)
    noise = 0.01 * np.random.default_rng(0).normal(size=scenario.ecg.samples.shape)
    write_ecg_csv(dataclasses.replace(scenario.ecg, samples=noise), folder / "ecg.csv")
    replay_fails(folder, 3, "R peaks", "electrodes")


def test_tool_never_tracked(folder: Path, scenario: Scenario) -> None:
    lost = np.zeros(len(tool_of(scenario)), dtype=bool)
    write_poses(dataclasses.replace(tool_of(scenario), valid=lost), folder / "tool.igs.mha")
    replay_fails(folder, 3, "tool recording", "status OK")


def test_missing_recording(folder: Path) -> None:
    (folder / "calibration" / "pivot.igs.mha").unlink()
    replay_fails(folder, 3, "pivot.igs.mha")


def test_static_pivot_recording(folder: Path, scenario: Scenario) -> None:
    still = pivot_of(scenario)
    n = len(still)
    static = dataclasses.replace(
        still,
        rotations=np.tile(still.rotations[0], (n, 1, 1)),
        translations_mm=np.tile(still.translations_mm[0], (n, 1)),
    )
    write_poses(static, folder / "calibration" / "pivot.igs.mha")
    replay_fails(folder, 7, "pivot")


def test_model_of_another_patient(folder: Path, replay: Replay, tmp_path: Path) -> None:
    foreign = tmp_path / "other.npz"
    write_model(dataclasses.replace(replay.heart.model, patient_id="somebody else"), foreign)
    replay_fails(folder, 3, "somebody else", extra=("--model", str(foreign)))


def test_damaged_model(folder: Path, replay: Replay, tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    write_model(replay.heart.model, path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    replay_fails(folder, 3, "model.npz", extra=("--model", str(path)))


def test_sheared_nifti(tmp_path: Path) -> None:
    path, out = tmp_path / "sheared.nii", tmp_path / "out"
    image = sitk.GetImageFromArray(np.ones((6, 6, 6), dtype=np.float32))
    sitk.WriteImage(image, str(path))
    raw = bytearray(path.read_bytes())
    sform = np.array([[1, 0.2, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], dtype="<f4")
    raw[252:254] = np.int16(0).tobytes()  # no qform
    raw[254:256] = np.int16(1).tobytes()  # sform: scanner
    raw[280:328] = sform.tobytes()
    path.write_bytes(raw)
    fails(
        ["register", "--fixed", str(path), "--moving", str(path), "-o", str(out)], 3, "sheared.nii", "shear"
    )
    assert not out.exists()


def test_not_a_scenario(tmp_path: Path) -> None:
    replay_fails(tmp_path / "nowhere", 3, "nowhere")


def test_unwritable_output(folder: Path, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    target = str(blocked / "run")
    fails(["replay", str(folder), "-o", target], 4, "file")


def test_usage_errors_exit_2(tmp_path: Path) -> None:
    assert CliRunner().invoke(app, ["replay", "--nonsense"]).exit_code == 2
    both = ["register", str(tmp_path), "--fixed", "a", "--moving", "b", "-o", "x"]
    assert CliRunner().invoke(app, both).exit_code == 2
