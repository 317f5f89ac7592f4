"""Poses relative to a PLUS reference marker, and sensors under a lab's own names: the same recordings."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from toy_lab import IMAGE, SESSION, sweep, write_calibration, write_lab
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import (
    DvfModel,
    ImageMap,
    NotConvergedError,
    Points,
    PoseStream,
    Rigid,
    Scenario,
    TrackedSequence,
)
from dvf_ig.io import write_coordinate_definitions, write_poses, write_sequence, write_transform

REPLAYED = {k: v for k, v in SESSION.items() if k != "tool"}
REGISTERED = REPLAYED | {"start": {"transform": "start.tfm"}}


def streams() -> tuple[PoseStream, PoseStream, PoseStream]:
    """Probe, tool and reference marker, as the tracker sees them."""
    probe = sweep().poses["tracker_from_probe"]
    marker = Rotation.from_rotvec(np.outer(0.02 * probe.t_s, [0.0, 0.0, 1.0])).as_matrix()
    needle = replace(probe, source="needle", translations_mm=probe.translations_mm[::-1].copy())
    held = replace(probe, source="reference", rotations=marker, translations_mm=0.3 * probe.translations_mm)
    return probe, needle, held


def sequence(*poses: PoseStream) -> TrackedSequence:
    images = sweep()
    return TrackedSequence(images.t_s, images.images, images.image_valid, {s.name: s for s in poses})


@pytest.fixture(scope="module")
def files(ball: DvfModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """one.igs.mha: UsSensorToReference and NeedleToReference; raw.igs.mha: as the tracker saw all three."""
    folder = tmp_path_factory.mktemp("lab")
    write_lab(folder, ball)
    probe, needle, held = streams()
    sensor = replace(probe, source="us_sensor")
    relative = [replace(held.inverse() @ one, t_s=probe.t_s) for one in (sensor, needle)]
    write_sequence(sequence(*relative), folder / "one.igs.mha")
    write_sequence(sequence(sensor, needle, held), folder / "raw.igs.mha")
    write_sequence(sequence(relative[0]), folder / "sensor.igs.mha")
    write_poses(relative[1], folder / "relative_needle.igs.mha")
    tip = replace(relative[1], source="needle_tip")
    write_sequence(sequence(*relative, tip, held.inverse()), folder / "tip.igs.mha")
    for name in ("us_sensor", "ussensor"):
        write_calibration(
            folder / f"{name}.json", "probe", sensor_frame=name, sensor_from_image=IMAGE.tolist()
        )
    write_coordinate_definitions(folder / "device.xml", {"us_sensor_from_image": IMAGE})
    write_transform(Rigid.identity("mr", "tracker"), folder / "start.tfm")
    return folder


class Given:
    """Keeps the recordings that would be registered or replayed."""

    def __init__(self) -> None:
        self.scenario: Scenario | None = None

    def __call__(self, scenario: Scenario, *_: object, **__: object) -> None:
        self.scenario = scenario
        raise NotConvergedError("the work began")


@pytest.fixture
def given(files: Path, monkeypatch: pytest.MonkeyPatch) -> Given:
    """The working directory is the lab's."""
    found = Given()
    monkeypatch.chdir(files)
    monkeypatch.setattr("dvf_ig.replay.registration.recorded_ultrasound", found)
    monkeypatch.setattr("dvf_ig.replay.run_replay", found)
    return found


def run(given: Given, *arguments: str) -> Scenario:
    done = CliRunner().invoke(app, list(arguments))
    assert given.scenario is not None, done.output
    return given.scenario


def replayed(given: Given, files: Path, **changed: Any) -> Scenario:
    (files / "session.yaml").write_text(yaml.safe_dump(REPLAYED | changed))
    return run(given, "replay", "session.yaml", "-o", "out")


def registered(given: Given, files: Path, probe: str, **names: str) -> Scenario:
    document = REGISTERED | {
        "ultrasound": {"file": "one.igs.mha", **names},
        "calibration": {"probe": probe, "latency": -0.065},
    }
    (files / "session.yaml").write_text(yaml.safe_dump(document))
    return run(given, "register", "session.yaml", "-o", "out")


def assert_as_recorded(found: Scenario, *, relative: bool = True, tool: bool = True) -> None:
    """Poses as the plain recording gives them: relative to the marker, under the usual names."""
    probe, needle, held = streams()
    pairs = [(found.ultrasound.stream("tracker", "probe"), probe)]
    if tool:
        assert found.tool is not None
        pairs.append((found.tool, needle))
    for stream, plain in pairs:
        expected = held.inverse() @ plain if relative else plain
        np.testing.assert_allclose(stream.rotations, expected.rotations, rtol=0, atol=1e-9)
        np.testing.assert_allclose(stream.translations_mm, expected.translations_mm, rtol=0, atol=1e-9)
    assert found.tracked_against == ("reference" if relative else "tracker")
    assert isinstance(found.probe, ImageMap)
    assert found.probe.rigid.target == "probe"
    np.testing.assert_allclose(found.probe.matrix, IMAGE, atol=1e-12)


@pytest.mark.parametrize("name", ["UsSensor", "us_sensor", "USSensor"])
@pytest.mark.parametrize("calibration", ["us_sensor.json", "ussensor.json"])
def test_a_session_names_the_sensor(name: str, calibration: str, given: Given, files: Path) -> None:
    assert_as_recorded(registered(given, files, calibration, probe_name=name))


def test_a_device_set_and_the_reference_by_name(given: Given, files: Path) -> None:
    names = {"probe_name": "UsSensor", "reference_name": "Reference"}
    assert_as_recorded(registered(given, files, "device.xml", **names))


SWEEPS: dict[str, dict[str, Any]] = {
    "tool in the same sequence": {"ultrasound": {"file": "one.igs.mha"}},
    "as the tracker saw all": {"ultrasound": {"file": "raw.igs.mha"}},
    "its tip recorded, too": {"ultrasound": {"file": "tip.igs.mha"}},
    "tool by name": {
        "ultrasound": {"file": "one.igs.mha"},
        "tool": {"file": "one.igs.mha", "name": "Needle"},
    },
    "a sequence of its own": {
        "ultrasound": {"file": "sensor.igs.mha"},
        "tool": {"file": "relative_needle.igs.mha"},
    },
}


@pytest.mark.parametrize("case", SWEEPS)
def test_a_session_under_other_names(case: str, given: Given, files: Path) -> None:
    changed = json.loads(json.dumps(SWEEPS[case]))
    changed["ultrasound"]["probe_name"] = "UsSensor"
    calibration = SESSION["calibration"] | {"probe": "us_sensor.json"}
    found = replayed(given, files, **changed, calibration=calibration)
    assert_as_recorded(found)
    assert isinstance(found.tip, Points)
    assert found.tip.frame == "tool"


def test_the_tracker_in_place_of_the_marker(given: Given, files: Path) -> None:
    named = {"file": "raw.igs.mha", "probe_name": "UsSensor", "reference_name": "Tracker"}
    calibration = SESSION["calibration"] | {"probe": "us_sensor.json"}
    found = replayed(given, files, ultrasound=named, calibration=calibration)
    assert_as_recorded(found, relative=False)


def test_which_of_several_tools_is_asked(given: Given, files: Path) -> None:
    probe, needle, _ = streams()
    write_sequence(sequence(probe, needle, replace(needle, source="stylus")), files / "two.igs.mha")
    (files / "session.yaml").write_text(yaml.safe_dump(REPLAYED | {"ultrasound": "two.igs.mha"}))
    done = CliRunner().invoke(app, ["replay", "session.yaml", "-o", "out"])
    assert done.exit_code == 3
    assert given.scenario is None
    assert "the ultrasound tracks needle and stylus beside the probe; say which is the tool" in done.stderr
