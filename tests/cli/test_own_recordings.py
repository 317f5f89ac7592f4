"""A scenario taken apart by hand: its recordings as a lab's own files give the scenario's own result."""

import json
import shutil
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edf_files import write_ecg_edf
from typer.testing import CliRunner

from dvf_ig.cardiac import detect_r_peaks
from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, PoseStream, Preop, Scenario, Signal
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.intake.model_cache import model_key
from dvf_ig.intake.start import start_pose
from dvf_ig.io import add_ecg_field
from dvf_ig.preop import ModelOptions
from dvf_ig.registration import RegistrationResult
from dvf_ig.replay import Replay
from dvf_ig.replay.registration import PreparedRegistration, prepare_registration
from dvf_ig.session.heart import Heart

BLOOD = "2,4,6,7,8"
SESSION = """
schema: dvf_ig.session/1
preop: {mr: cine.nrrd, labels: labels.nrrd, timing: timing.json, cavity_labels: [2, 4, 6, 7, 8]}
ultrasound:
  file: sweep.igs.mha
  fan: {apex_px: [171.5, 6.0], start_px: 0.0, stop_px: 300.0, half_angle_rad: 0.6108652381980153}
ecg: edf:ecg.edf
tool: needle.igs.mha
calibration: {probe: probe.json, latency: latency.json, tip: tip.json}
start: {transform: start.tfm, landmarks_mr: model.mrk.json, landmarks_tracker: patient.mrk.json}
"""


def run(*words: object, code: int = 0) -> dict[str, Any]:
    done = CliRunner().invoke(app, [*map(str, words), "--json"])
    assert done.exit_code == code, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def lab(scenario: Scenario, written: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scenario's recordings under other names, its calibrations as `calibrate` writes them."""
    folder = tmp_path_factory.mktemp("lab")
    for name, source in {
        "cine.nrrd": "preop/mr.nrrd",
        "labels.nrrd": "preop/labels.nrrd",
        "timing.json": "preop/timing.json",
        "needle.igs.mha": "tool.igs.mha",
        "sweep.igs.mha": "ultrasound.igs.mha",
        "start.tfm": "start.tfm",
        "start.json": "start.json",
        "model.mrk.json": "landmarks_mr.mrk.json",
        "patient.mrk.json": "landmarks_tracker.mrk.json",
    }.items():
        shutil.copy(written / source, folder / name)
    assert isinstance(scenario.ecg, Signal)
    write_ecg_edf(scenario.ecg, folder / "ecg.edf")
    add_ecg_field(folder / "sweep.igs.mha", scenario.ecg, folder / "sweep_with_ecg.igs.mha")
    recorded = written / "calibration"
    device_set, points = recorded / "nwire.xml", recorded / "nwire_points.xml"
    run("calibrate", "pivot", recorded / "pivot.igs.mha", "-o", folder / "tip.json")
    run("calibrate", "probe", recorded / "nwire.igs.mha", "--device-set", device_set, "--points", points,
        "-o", folder / "probe.json")  # fmt: skip
    tank = [recorded / f"latency_{part}.igs.mha" for part in ("tracker", "video")]
    lines = recorded / "latency_lines.xml"
    run("calibrate", "latency", *tank, "--line-table", lines, "-o", folder / "latency.json")
    return folder


@pytest.fixture
def model_of_the_same_data(scenario: Scenario, replay: Replay, monkeypatch: pytest.MonkeyPatch) -> None:
    """The replay's model where labels, grid and times are its own, by any names: building it takes long."""
    own = scenario.preop

    def found(preop: Preop, *, options: ModelOptions, **_: object) -> DvfModel:
        assert (preop.blood_labels, preop.lv_label) == (own.blood_labels, own.lv_label)
        same = replace(preop, patient_id=own.patient_id, label_names=own.label_names, cavity_labels=())
        assert model_key(same, options) == model_key(own, ModelOptions())
        return replace(replay.heart.model, patient_id=preop.patient_id)

    monkeypatch.setattr("dvf_ig.preop.model_from_preop", found)


@pytest.mark.usefixtures("model_of_the_same_data")
def test_register_with_the_ecg_inside_the_sweep(
    scenario: Scenario,
    replay: Replay,
    registered: RegistrationResult,
    lab: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An option of `config init` for each file; phases and patient come from the files alone.

    The registration is given what the scenario's own was given: its result follows from that.
    """
    prepared: list[PreparedRegistration] = []

    def captured(given: PreparedRegistration, **_: object) -> RegistrationResult:
        prepared.append(given)
        return registered

    def heart_of_the_same_images(preop: Preop, model: DvfModel, **_: object) -> Heart:
        assert preop.mr is not None
        assert scenario.preop.mr is not None
        np.testing.assert_array_equal(preop.mr.values, scenario.preop.mr.values)
        np.testing.assert_array_equal(model.coefficients, replay.heart.model.coefficients)
        return replay.heart

    monkeypatch.setattr(PreparedRegistration, "register", captured)
    monkeypatch.setattr("dvf_ig.replay.registration.build_heart", heart_of_the_same_images)
    session = tmp_path / "session.yaml"
    run(
        "config", "init", "--us", lab / "sweep_with_ecg.igs.mha", "--cine", lab / "cine.nrrd",
        "--labels", lab / "labels.nrrd", "--cavity", BLOOD, "--probe", lab / "probe.json",
        "--latency", lab / "latency.json", "--start", lab / "start.tfm", "-o", session,
    )  # fmt: skip
    found = run("register", session, "-o", tmp_path / "out")
    np.testing.assert_array_equal(found["mr_from_tracker"], registered.target_from_source.matrix)
    own, (read,) = prepare_registration(scenario, heart=replay.heart), prepared
    np.testing.assert_allclose(read.start.matrix, own.start.matrix, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(read.recording.images, own.recording.images)
    used, theirs = read.recording.calibrations, own.recording.calibrations
    np.testing.assert_allclose(used.probe_from_image.matrix, theirs.probe_from_image.matrix, atol=1e-9)
    np.testing.assert_array_equal(read.frames.used, own.frames.used)
    for name in ("event_s", "model_phase", "rotations", "translations_mm"):
        np.testing.assert_allclose(getattr(read.frames, name), getattr(own.frames, name), atol=1e-6)


@pytest.mark.usefixtures("model_of_the_same_data")
def test_replay_with_the_ecg_as_edf(
    replay: Replay, lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From one YAML a replay is given what the scenario's own was given: all else follows from that."""
    given: dict[str, Any] = {}

    def captured(scenario: Scenario, **options: Any) -> Replay:
        given.update(options, scenario=scenario)
        return replace(replay, scenario=scenario)

    monkeypatch.setattr("dvf_ig.replay.run_replay", captured)
    (lab / "SESSION.yaml").write_text(SESSION)
    found = run("replay", lab / "SESSION.yaml", "-o", tmp_path / "run")
    assert found["tre_mm"] is None
    recorded, own = given["scenario"], replay.scenario
    assert own.tool is not None
    assert isinstance(own.ecg, Signal)
    beats = [np.array([peak.t_s for peak in detect_r_peaks(ecg)]) for ecg in (recorded.ecg, own.ecg)]
    np.testing.assert_allclose(*beats, rtol=0, atol=1e-9)
    assert len(beats[0]) >= 15
    for stream, as_given in ((recorded.tool, own.tool), *_streams(recorded, own)):
        assert (stream.target, stream.source) == (as_given.target, as_given.source)
        for name in ("t_s", "rotations", "translations_mm", "valid"):
            np.testing.assert_allclose(getattr(stream, name), getattr(as_given, name), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(recorded.ultrasound.images, own.ultrasound.images)
    np.testing.assert_allclose(np.hstack(astuple(recorded.fan)), np.hstack(astuple(own.fan)), atol=1e-9)
    assert given["seed"] == 0
    start = start_pose(recorded, replay.heart, 0)
    np.testing.assert_allclose(start.matrix, replay.start.matrix, rtol=0, atol=1e-9)
    used, theirs = calibrate(recorded, 0).in_use, replay.calibrations.in_use
    assert used.lag_s == pytest.approx(theirs.lag_s, abs=1e-12)
    np.testing.assert_allclose(used.tip.xyz_mm, theirs.tip.xyz_mm, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        used.probe_from_image.matrix, theirs.probe_from_image.matrix, rtol=0, atol=1e-9
    )
    np.testing.assert_array_equal(given["model"].coefficients, replay.heart.model.coefficients)


def _streams(*scenarios: Scenario) -> list[tuple[PoseStream, ...]]:
    """The same stream of each scenario's ultrasound."""
    ours, theirs = (scenario.ultrasound.poses for scenario in scenarios)
    assert set(ours) == set(theirs)
    return [(ours[name], theirs[name]) for name in ours]
