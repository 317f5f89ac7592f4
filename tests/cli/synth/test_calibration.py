"""Calibration recordings from the command line, read back by the calibrations themselves."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.io import read_sequence


def truth_of(folder: Path) -> dict[str, object]:
    assert (folder / "README.md").is_file()
    truth: dict[str, object] = json.loads((folder / "truth.json").read_text())
    return truth


def result(*arguments: object) -> dict[str, object]:
    done = CliRunner().invoke(app, ["calibrate", *map(str, arguments), "--json"])
    assert done.exit_code == 0, done.output
    found: dict[str, object] = json.loads(done.stdout)
    return found


def test_pivot(calibration_recordings: Path) -> None:
    folder = calibration_recordings / "pivot"
    truth = truth_of(folder)
    found = result("pivot", folder / "pivot.igs.mha")
    assert np.linalg.norm(np.subtract(found["tip_mm"], truth["tip_mm"])) < 0.2


def test_nwire(calibration_recordings: Path) -> None:
    folder = calibration_recordings / "nwire"
    truth = truth_of(folder)
    files = ["--device-set", folder / "nwire.xml", "--points", folder / "nwire_points.xml"]
    found = result("probe", folder / "nwire.igs.mha", *files)
    corner = np.array([[0.0, 0, 0, 1], [343, 319, 0, 1]]).T
    difference = (np.array(found["sensor_from_image"]) - np.array(truth["probe_from_image"])) @ corner
    assert np.linalg.norm(difference[:3], axis=0).max() < 1.0
    images = read_sequence(folder / "nwire.igs.mha").images
    assert images is not None
    assert images.shape == (120, 320, 344)


def test_the_lag_is_found_from_the_images_as_from_the_lines(calibration_recordings: Path) -> None:
    folder = calibration_recordings / "watertank"
    truth = truth_of(folder)
    for lines in (["--line-table", folder / "lines.xml"], []):
        found = result("latency", folder / "tracker.igs.mha", folder / "video.igs.mha", *lines)
        assert found["lag_s"] == pytest.approx(truth["lag_s"], abs=0.003)


@pytest.mark.parametrize("kind", ["cross-wire", "wall"])
def test_points_belong_to_images(calibration_recordings: Path, kind: str) -> None:
    folder = calibration_recordings / kind
    truth = truth_of(folder)
    sequence = read_sequence(folder / f"{kind}.igs.mha")
    with (folder / f"{kind}_points.csv").open() as stream:
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
