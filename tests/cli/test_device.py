"""`dvf-ig device` and `dvf-ig calibrate device`: what is there, a ball to feel, and the place of a device."""

import json
from pathlib import Path

import numpy as np
import pytest
from fake_library import BUTTON, POSITION, SharedDhd, compiled
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import Landmarks, Points, Rigid
from dvf_ig.io import write_landmarks, write_model
from dvf_ig.io.calibration_files import read_landmark_map
from dvf_ig.study.passivity import wall_model
from dvf_ig.study.tissue import tissue_wall

PLACE = Rigid.from_rotation_vector([0.3, -0.2, 0.5], [40.0, -10.0, 5.0], "tracker", "device")
NAMES = ("a", "b", "c", "d")
CORNERS = np.array([[1.0, 0, 0], [80, 0, 0], [0, 60, 0], [0, 0, 50]])


def test_missing_libraries_are_listed_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("FORCEDIM_SDK", str(tmp_path))
    done = CliRunner().invoke(app, ["device", "list", "--json"])
    assert done.exit_code == 0, done.output
    found = {one["name"]: one for one in json.loads(done.stdout)["devices"]}
    assert "install the SDK" in found["force-dimension"]["problem"]
    assert "install OpenHaptics" in found["openhaptics"]["problem"]
    assert found["simulated:omni"]["continuous_force_n"] == 0.88


def test_a_simulated_hand_feels_the_ball() -> None:
    done = CliRunner().invoke(app, ["device", "test", "--seconds", "1.5", "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["ticks"] + 1 > result["run_share"] * 1000
    assert 0.0 < result["largest_force_n"] <= 0.6
    assert result["deepest_mm"] < 5.0, "the ball holds the hand back"


def test_a_simulated_hand_feels_tissue_in_a_mode_of_its_own(tmp_path: Path) -> None:
    model = tmp_path / "wall.npz"
    write_model(tissue_wall(["lv_myocardium"]), model)
    command = ["device", "test", "--device", "simulated:omni", "--seconds", "1.5"]
    done = CliRunner().invoke(app, [*command, "--feel", str(model), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert [one["name"] for one in result["tissue"]] == ["myocardium"]
    assert result["tissue"][0]["friction"]["source"].startswith("Loring")
    assert "friction of myocardium cannot be rendered on the simulated PHANToM Omni" in done.stderr
    refused = CliRunner().invoke(app, ["serve", str(tmp_path), "--feel", str(model)])
    assert refused.exit_code == 2
    assert "gives no force that is made up" in " ".join(refused.output.replace("│", " ").split())
    without = CliRunner().invoke(app, [*command, "--feel", str(write_without(tmp_path))])
    assert without.exit_code == 3
    assert "keeps no labels to feel" in " ".join(without.output.split())


def write_without(folder: Path) -> Path:
    """A model of an earlier version, without labels."""
    write_model(wall_model(), folder / "old.npz")
    return folder / "old.npz"


def test_an_unknown_device_exits_3_and_names_those_that_are_known() -> None:
    done = CliRunner().invoke(app, ["device", "test", "--device", "falcon"])
    assert done.exit_code == 3
    assert "force-dimension, openhaptics, simulated" in done.output.replace("\n", " ")


@pytest.mark.parametrize(("error_mm", "code"), [(0.0, 0), (12.0, 7)])
def test_touched_points_place_a_device(tmp_path: Path, error_mm: float, code: int) -> None:
    touched, corners, out = (
        tmp_path / name for name in ("touched.mrk.json", "corners.mrk.json", "device.json")
    )
    moved = PLACE.apply_array(CORNERS)
    moved[3, 0] += error_mm
    write_landmarks(Landmarks(NAMES, Points("device", CORNERS)), touched)
    write_landmarks(Landmarks(NAMES, Points("tracker", moved)), corners)
    command = ["calibrate", "device", str(corners), "--touched", str(touched), "-o", str(out), "--json"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == code, done.output
    if code == 0:
        np.testing.assert_allclose(read_landmark_map(out).matrix, PLACE.matrix, atol=1e-6)
    else:
        assert "touch them again" in json.loads(done.stdout)["refused_because"][0]


def test_points_are_touched_with_a_device_and_its_button(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each press moves the fake device on to the next point, as a hand would."""
    library = compiled("fake_dhd", tmp_path, "libdhd.so")
    monkeypatch.setattr("dvf_ig.guidance.devices.force_dimension.LIBRARY", str(library))
    monkeypatch.delenv("FORCEDIM_SDK", raising=False)
    state = SharedDhd(tmp_path / "dhd", (0.0, 0.0, 0.0))
    monkeypatch.setenv("FAKE_DHD", str(state.path))
    corners, out, turn = tmp_path / "corners.mrk.json", tmp_path / "device.json", iter(CORNERS)

    def press(*_: object) -> None:
        state.numbers[POSITION : POSITION + 3] = 1e-3 * next(turn)

    monkeypatch.setattr("dvf_ig.cli.calibrate.device._wait_confirmed", press)
    write_landmarks(Landmarks(NAMES, PLACE.apply(Points("device", CORNERS))), corners)
    done = CliRunner().invoke(
        app, ["calibrate", "device", str(corners), "--device", "force-dimension", "-o", str(out)]
    )
    assert done.exit_code == 0, done.output
    np.testing.assert_allclose(read_landmark_map(out).matrix, PLACE.matrix, atol=1e-6)
    assert state.numbers[BUTTON] == 0
