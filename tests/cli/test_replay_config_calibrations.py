"""Calibrations of a SESSION.yaml in each form that a lab has them: each gives the truth of its recording."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from toy_lab import IMAGE, SESSION, write_ecg, write_lab

from dvf_ig.core import DvfModel, Scenario, Signal, TrackedSequence, TriggerTimes, UnreadableFileError
from dvf_ig.intake.calibrations import Calibrations, calibrate
from dvf_ig.intake.session import read_session
from dvf_ig.io import read_poses, write_coordinate_definitions, write_poses, write_sequence

FAR_PX = np.array([[0, 0, 0, 1], [300, 0, 0, 1], [0, 300, 0, 1], [300, 300, 0, 1.0]])


@pytest.fixture(scope="module")
def lab(ball: DvfModel, calibration_recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lab's files, and the recordings of its calibrations, each in a folder of its kind."""
    folder = tmp_path_factory.mktemp("lab")
    write_lab(folder, ball)
    for recorded in calibration_recordings.iterdir():
        (folder / recorded.name).symlink_to(recorded)
    return folder


def session(lab: Path, **changed: Any) -> Scenario:
    """What a SESSION.yaml names; a calibration that is not given is the lab's own file."""
    calibration = SESSION["calibration"] | changed.pop("calibration", {})
    (lab / "SESSION.yaml").write_text(yaml.safe_dump(SESSION | changed | {"calibration": calibration}))
    return read_session(lab / "SESSION.yaml").scenario


def calibrated(lab: Path, **calibration: Any) -> Calibrations:
    return calibrate(session(lab, calibration=calibration), seed=0)


def truth(lab: Path, kind: str) -> dict[str, Any]:
    return dict(json.loads((lab / kind / "truth.json").read_text()))


TANK = {
    "tracker": "watertank/tracker.igs.mha",
    "video": "watertank/video.igs.mha",
    "lines": "watertank/lines.xml",
}
PROBES = {
    "nwire": {"device_set": "nwire/nwire.xml", "points": "nwire/nwire_points.xml"},
    "cross-wire": {"points": "cross-wire/cross-wire_points.csv"},
    "wall": {"points": "wall/wall_points.csv"},
}


@pytest.mark.parametrize("phantom", PROBES)
def test_a_sweep_of_a_phantom(phantom: str, lab: Path) -> None:
    file = f"{phantom}/{phantom}.igs.mha"
    found = calibrated(lab, probe={"phantom": phantom, "file": file, **PROBES[phantom]})
    off = (
        FAR_PX
        @ (found.ultrasound.probe_from_image.matrix - np.array(truth(lab, phantom)["probe_from_image"])).T
    )
    assert np.linalg.norm(off, axis=1).max() < 1.5
    assert found.probe is not None


def test_a_probe_in_the_xml_of_plus(lab: Path) -> None:
    write_coordinate_definitions(lab / "device.xml", {"probe_from_image": IMAGE})
    found = calibrated(lab, probe="device.xml")
    np.testing.assert_allclose(found.ultrasound.probe_from_image.matrix[:, [0, 1, 3]], IMAGE[:, [0, 1, 3]])


def test_latency_as_recording_seconds_and_file(lab: Path) -> None:
    found = calibrated(lab, latency=TANK).ultrasound.lag_s
    assert found == pytest.approx(truth(lab, "watertank")["lag_s"], abs=0.004)
    assert calibrated(lab, latency=-0.065).ultrasound.lag_s == -0.065
    assert calibrated(lab, latency="latency.json").ultrasound.lag_s == -0.065


def test_a_tank_recorded_under_other_names(lab: Path) -> None:
    """The probe's poses are relative to a reference marker; nothing is called Probe or Tracker."""
    tank = {"tracker": "other.igs.mha", "video": "watertank/video.igs.mha", "lines": "watertank/lines.xml"}
    rename(lab / "watertank/tracker.igs.mha", lab / "other.igs.mha")
    rename(lab / "sweep.igs.mha", lab / "other_sweep.igs.mha")
    device_set = {"us_sensor_from_image": IMAGE}
    write_coordinate_definitions(lab / "other.xml", device_set)
    sweep = {"file": "other_sweep.igs.mha", "probe_name": "UsSensor"}
    found = session(lab, ultrasound=sweep, tool=None, calibration={"latency": tank, "probe": "other.xml"})
    assert calibrate(found, 0).ultrasound.lag_s == calibrated(lab, latency=TANK).ultrasound.lag_s


def rename(source: Path, target: Path) -> None:
    """Poses of the probe as a laboratory with names of its own records them."""
    target.write_bytes(source.read_bytes().replace(b"ProbeToTracker", b"UsSensorToReference"))


@pytest.mark.parametrize("form", ["sequence", "of several tools", "folder", "table"])
def test_poses_while_pivoting(form: str, lab: Path, tmp_path: Path) -> None:
    poses = read_poses(lab / "pivot/pivot.igs.mha")
    path = tmp_path / "pivot"
    if form == "sequence":
        path = lab / "pivot/pivot.igs.mha"
    elif form == "of several tools":
        path = path.with_suffix(".igs.mha")
        needle = replace(poses, source="needle")
        still = replace(poses, source="stylus", translations_mm=np.zeros_like(poses.translations_mm))
        both = {stream.name: stream for stream in (needle, still)}
        write_sequence(TrackedSequence(poses.t_s, None, poses.valid, both), path)
    elif form == "folder":
        path.mkdir()
        for i, (turn, place) in enumerate(zip(poses.rotations, poses.translations_mm, strict=True)):
            np.savetxt(path / f"pose{i}.txt", np.vstack([np.column_stack([turn, place]), [0, 0, 0, 1]]))
    else:
        turns = Rotation.from_matrix(poses.rotations).as_quat()
        np.savetxt(path, np.column_stack([poses.translations_mm, turns]))
    tip = calibrated(lab, tip={"pivot": str(path)}).tip
    assert tip is not None
    assert np.linalg.norm(tip.xyz_mm[0] - truth(lab, "pivot")["tip_mm"]) < 0.3


def test_poses_of_another_tool_are_refused(lab: Path, tmp_path: Path) -> None:
    poses = replace(read_poses(lab / "pivot/pivot.igs.mha"), source="stylus")
    write_poses(poses, tmp_path / "pivot.igs.mha")
    with pytest.raises(UnreadableFileError, match="tracks stylus, but the recorded tool is 'needle'"):
        calibrated(lab, tip={"pivot": str(tmp_path / "pivot.igs.mha")})


def test_a_tip_in_the_xml_of_plus(lab: Path) -> None:
    needle_from_tip, other = np.eye(4), np.eye(4)
    needle_from_tip[:3, 3] = (1.5, -2.0, 150.25)
    tips = {"needle_from_needle_tip": needle_from_tip, "stylus_from_stylus_tip": other}
    write_coordinate_definitions(lab / "tip.xml", tips)
    tip = calibrated(lab, tip="tip.xml").tip
    assert tip is not None
    assert tip.frame == "tool"
    np.testing.assert_array_equal(tip.xyz_mm[0], needle_from_tip[:3, 3])


def test_beats_from_a_trigger_or_a_table(lab: Path) -> None:
    plain = session(lab).ecg
    assert isinstance(plain, Signal)
    beats_s = 0.4 + 0.8 * np.arange(14)
    (lab / "pulses.csv").write_text("t_s\n" + "\n".join(f"{t:.3f}" for t in beats_s) + "\n")
    trigger = session(lab, ecg={"file": "trigger:pulses.csv", "delay_s": 0.02}).ecg
    assert isinstance(trigger, TriggerTimes)
    np.testing.assert_allclose(trigger.t_s, beats_s)
    write_ecg(lab / "bare.csv", times=False)
    later = session(lab, ecg={"file": "bare.csv", "rate_hz": 250, "start_s": 3.0}).ecg
    assert isinstance(later, Signal)
    assert later.start_s == 3.0
    np.testing.assert_allclose(later.samples, plain.samples, atol=1e-5)
