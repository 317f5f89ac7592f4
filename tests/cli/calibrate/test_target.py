"""`dvf-ig calibrate probe --phantom cross-wire|wall`: from synthetic recordings to JSON and PLUS XML."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.io import read_coordinate_definitions


def run(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, [*map(str, arguments)])
    return done.exit_code, done.stdout, done.output


@pytest.mark.parametrize("phantom", ["cross-wire", "wall"])
def test_json_is_as_for_n_wires_and_the_truth_is_met(
    calibration_recordings: Path, tmp_path: Path, phantom: str
) -> None:
    folder = calibration_recordings / phantom
    truth = json.loads((folder / "truth.json").read_text())
    sequence, points = folder / f"{phantom}.igs.mha", folder / f"{phantom}_points.csv"
    files = ["--points", points, "--validate", sequence, "--validate-points", points]
    out = tmp_path / "probe.json"
    code, text, output = run(
        "calibrate", "probe", sequence, "--phantom", phantom, *files, "--json", "-o", out
    )
    assert code == 0, output
    found = json.loads(text)
    for part in ("calibration", "validation"):
        assert set(found[part]) == {"mean_mm", "sd_mm", "mean95_mm", "sd95_mm", "frames_used", "frames"}
    half = found["uncertainty"]["center_half_width_mm"]
    pixel = np.array([*found["uncertainty"]["center_px"], 0.0, 1.0])
    gap = (np.array(found["sensor_from_image"]) - np.array(truth["probe_from_image"])) @ pixel
    # two 95 % half-widths
    assert np.linalg.norm(gap[:3]) < 2 * np.linalg.norm(list(half.values()))
    assert len(found["rejected"]) + found["inlier_frames"] == 60
    if phantom == "cross-wire":
        assert np.linalg.norm(np.subtract(found["crossing_mm"], truth["crossing_tracker_mm"])) < 0.5
    else:
        assert abs(np.dot(found["wall_normal"], truth["wall_normal_tracker"])) > 0.9999
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    saved = read_coordinate_definitions(out.with_suffix(".xml"))["probe_from_image"]
    assert saved.tolist() == found["sensor_from_image"]


def test_missing_points_and_wrong_options_are_said(calibration_recordings: Path) -> None:
    folder = calibration_recordings / "cross-wire"
    sequence = folder / "cross-wire.igs.mha"
    code, _, output = run("calibrate", "probe", sequence, "--phantom", "cross-wire")
    assert code == 3
    assert "--points" in output
    points = folder / "cross-wire_points.csv"
    code, _, output = run(
        "calibrate", "probe", sequence, "--phantom", "cross-wire", "--points", points, "--method", "linear"
    )
    assert code == 3
    assert "orthogonal or isotropic" in output
    code, _, output = run("calibrate", "probe", sequence, "--phantom", "wall", "--points", points)
    assert code == 3
    assert "given by 2" in output
    code, _, output = run("calibrate", "probe", sequence)
    assert code == 3
    assert "--device-set" in output
