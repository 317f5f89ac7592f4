"""Calibration recordings from the command line, read back by the calibrations themselves."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.io import read_sequence


def made(kind: str, folder: Path) -> dict[str, object]:
    done = CliRunner().invoke(app, ["synth", "calibration", kind, "-o", str(folder), "--seed", "5"])
    assert done.exit_code == 0, done.output
    assert (folder / "README.md").is_file()
    truth: dict[str, object] = json.loads((folder / "truth.json").read_text())
    return truth


def result(*arguments: object) -> dict[str, object]:
    done = CliRunner().invoke(app, ["calibrate", *map(str, arguments), "--json"])
    assert done.exit_code == 0, done.output
    found: dict[str, object] = json.loads(done.stdout)
    return found


def test_pivot(tmp_path: Path) -> None:
    truth = made("pivot", tmp_path)
    found = result("pivot", tmp_path / "pivot.igs.mha")
    assert np.linalg.norm(np.subtract(found["tip_mm"], truth["tip_mm"])) < 0.2


def test_nwire(tmp_path: Path) -> None:
    truth = made("nwire", tmp_path)
    files = ["--device-set", tmp_path / "nwire.xml", "--points", tmp_path / "nwire_points.xml"]
    found = result("probe", tmp_path / "nwire.igs.mha", *files)
    corner = np.array([[0.0, 0, 0, 1], [343, 319, 0, 1]]).T
    difference = (np.array(found["sensor_from_image"]) - np.array(truth["probe_from_image"])) @ corner
    assert np.linalg.norm(difference[:3], axis=0).max() < 1.0
    images = read_sequence(tmp_path / "nwire.igs.mha").images
    assert images is not None
    assert images.shape == (120, 320, 344)


def test_the_lag_is_found_from_the_images_as_from_the_lines(tmp_path: Path) -> None:
    truth = made("watertank", tmp_path)
    for lines in (["--line-table", tmp_path / "lines.xml"], []):
        found = result("latency", tmp_path / "tracker.igs.mha", tmp_path / "video.igs.mha", *lines)
        assert found["lag_s"] == pytest.approx(truth["lag_s"], abs=0.003)


@pytest.mark.parametrize("kind", ["cross-wire", "wall"])
def test_points_belong_to_images(tmp_path: Path, kind: str) -> None:
    truth = made(kind, tmp_path)
    sequence = read_sequence(tmp_path / f"{kind}.igs.mha")
    with (tmp_path / f"{kind}_points.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(sequence)
    to_probe, misses = np.array(truth["probe_from_image"]), []
    stream_poses = sequence.stream("tracker", "probe")
    for i, row in enumerate(rows):
        if row["column1_px"] and stream_poses.valid[i]:
            pixel = np.array([float(row["column1_px"]), float(row["row1_px"]), 0.0, 1.0])
            point = (stream_poses.pose(i).matrix @ to_probe @ pixel)[:3]
            if kind == "wall":
                misses.append(np.array(truth["wall_normal_tracker"]) @ point - truth["wall_offset_mm"])
            else:
                misses.append(np.linalg.norm(point - truth["crossing_tracker_mm"]))
    # 0.3 mm of segmentation and out of plane, 0.2 mm and 0.1° of the tracker
    assert len(misses) > 50
    assert np.sqrt(np.mean(np.square(misses))) < 1.0
