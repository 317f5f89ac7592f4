"""`dvf-ig serve` and `dvf-ig synth stream`: a recording through both, and what is refused before."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from served_toy import ready, serve_toy
from toy_session import toy_setup
from typer.testing import CliRunner
from waiting import until

from dvf_ig.cli.main import app
from dvf_ig.core import (
    DvfIgError,
    InvalidInputError,
    Points,
    Respiration,
    Scenario,
    UnreadableFileError,
)
from dvf_ig.intake import read_session
from dvf_ig.intake.fit import require_live_fit
from dvf_ig.intake.live import EcgFieldConfig, EcgTailConfig, LiveConfig, require_orientation
from dvf_ig.intake.session import streamed_breath
from dvf_ig.io.json_file import write_json
from dvf_ig.io.writing.listing import LISTING
from dvf_ig.live.igtl import Image, Message, Text, Transform
from dvf_ig.live.link import Inbox, Link, connect, listen
from dvf_ig.live.player import BREATH, CHEST, ECG, IMAGE, PROBE, TOOL, messages_of, play
from dvf_ig.live.serve import device_names
from dvf_ig.replay.view_file import read_view_file

RUNNER = CliRunner()


def run(*arguments: object) -> Any:
    return RUNNER.invoke(app, [str(argument) for argument in arguments])


def test_recording_is_sent_as_plus_names_it(scenario: Scenario) -> None:
    """Every pose, image and sample, in order of time; a pose that was not tracked says so."""
    sent = list(messages_of(scenario, 1000.0))
    assert [t_s for t_s, _ in sent] == sorted(t_s for t_s, _ in sent)
    by_name = {name: [m for _, m in sent if m.device == name] for name in (PROBE, TOOL, IMAGE, ECG)}
    assert scenario.tool is not None
    assert len(by_name[TOOL]) == len(scenario.tool)
    assert len(by_name[PROBE]) == len(scenario.ultrasound)
    assert len(by_name[IMAGE]) == int(scenario.ultrasound.image_valid.sum())
    stamps = [m.stamp_s for m in by_name[PROBE]]
    assert stamps == pytest.approx((scenario.ultrasound.t_s + 1000.0).tolist())
    missing = [m.fields.get("TransformStatus") == "MISSING" for m in by_name[TOOL]]
    assert missing == [not valid for valid in scenario.tool.valid.tolist()]


def test_recording_comes_over_loopback(scenario: Scenario) -> None:
    """The first second of it, as fast as it goes; all that was sent arrives."""
    inbox, stop = Inbox(), threading.Event()
    with listen("127.0.0.1", 0, None) as server, connect("127.0.0.1", server.port, inbox):
        until(lambda: server.peers)

        def send(messages: tuple[Message, ...]) -> None:
            server.send(messages)
            if (messages[0].stamp_s or 0.0) >= 1001.0:
                stop.set()

        link = cast("Link", SimpleNamespace(send=send))
        sent = play(scenario, link, speed=10.0, origin_s=1000.0, stop=stop)
        arrived: list[Any] = []
        while len(arrived) < sent:
            taken = inbox.take(2.0)
            assert taken, "not all arrived"
            arrived += taken
    assert {a.taken.device for a in arrived} == {PROBE, TOOL, IMAGE, ECG}
    assert server.dropped == 0


@pytest.fixture
def toy_patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a configuration names is the toy's patient."""
    serve_toy(monkeypatch)


@contextmanager
def sending(*names: str) -> Iterator[int]:
    """Send poses, and images if they are named, every 10 ms; the port."""
    with listen("127.0.0.1", 0, None) as server:
        stop = threading.Event()

        def send() -> None:
            n = 0
            while not stop.wait(0.01):
                n += 1
                pose, image = np.eye(4), np.full((1, 24, 24), 100, dtype=np.uint8)
                pose[0, 3] = 0.01 * n
                for name in names:
                    content = Image(image, np.eye(4)) if name == IMAGE else Transform(pose)
                    server.send([Message(name, 1000.0 + 0.01 * n, content)])

        sender = threading.Thread(target=send)
        sender.start()
        try:
            yield server.port
        finally:
            stop.set()
            sender.join()


@pytest.mark.usefixtures("toy_patient")
def test_serve_ends_after_its_time_and_says_what_it_did() -> None:
    done = run("serve", "x", "--listen", "--port", 0, "--seconds", 0.3, "--page", 0, "--json")
    assert done.exit_code == 0, done.stderr
    assert "listening at 127.0.0.1:" in done.stderr
    assert "shown at http://127.0.0.1:" in done.stderr
    result = json.loads(done.stdout)
    assert result["answers"] == 0
    assert result["latency_ms"]["median"] is None
    assert result["connections"] == 0


@pytest.mark.usefixtures("toy_patient")
@pytest.mark.parametrize(
    ("sent", "seconds", "missing"), [((), 0.1, "pose of the tool"), ((TOOL,), 1.5, "ultrasound")]
)
def test_serve_says_that_a_record_without_tool_or_ultrasound_cannot_be_replayed(
    tmp_path: Path, sent: tuple[str, ...], seconds: float, missing: str
) -> None:
    pytest.importorskip("mcap", reason="session logs need mcap")
    pytest.importorskip("rosbags", reason="session logs need rosbags")
    with sending(*sent) as port:
        done = run("serve", "x", "--port", port, "--seconds", seconds, "-o", tmp_path / "run")
    assert done.exit_code == 0, done.stderr
    record = tmp_path / "run" / "session.mcap"
    assert f"{record} can be neither replayed nor viewed, because no {missing} came" in done.stderr
    refused = run("replay", record, "-o", tmp_path / "again")
    assert refused.exit_code == 3
    assert not (tmp_path / "again").exists()


@pytest.mark.usefixtures("toy_patient")
@pytest.mark.usefixtures("blank_pictures")
def test_serve_leaves_what_view_shows_and_refuses_a_folder_with_a_record(tmp_path: Path) -> None:
    """Poses of the tool alone are sent: there are states, and no force."""
    pytest.importorskip("mcap", reason="session logs need mcap")
    pytest.importorskip("rosbags", reason="session logs need rosbags")
    out = tmp_path / "run"
    with sending(TOOL, PROBE, IMAGE) as port:
        done = run("serve", "x", "--port", port, "--seconds", 1.5, "-o", out, "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["record"] == {"folder": str(out), "lost": 0, "failure": None}
    assert "no force was given: no registration was in use in 100% of the ticks" in done.stderr
    names = {"session.mcap", "result.json", "report.html", "view.json", "ticks.csv"}
    assert {file.name for file in out.iterdir()} - {LISTING} == names
    result = json.loads((out / "result.json").read_text())
    assert result["ticks"] > 50
    assert "no registration was in use" in result["no_force"]
    assert read_view_file(out).recording == out / "session.mcap"
    again = run("serve", "x", "--seconds", 0.1, "-o", out)
    assert again.exit_code == 4
    assert "never replaced" in again.stderr


@pytest.mark.usefixtures("toy_patient")
def test_serve_that_is_refused_leaves_no_record(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="session logs need mcap")
    pytest.importorskip("rosbags", reason="session logs need rosbags")
    out = tmp_path / "run"
    with listen("127.0.0.1", 0, None) as server:
        for folder, there in ((out, False), (tmp_path, True)):
            done = run("serve", "x", "--listen", "--port", server.port, "--seconds", 0.1, "-o", folder)
            assert done.exit_code == 3, done.stderr
            assert "cannot listen" in done.stderr
            assert folder.exists() is there
    assert not list(tmp_path.glob("session*"))


@pytest.mark.parametrize(
    ("changes", "key", "expected"),
    [
        ({"tip": Points("tool", np.array([[0.0, 0.0, 5000.0]]))}, "calibration.tip", "the tip lies"),
        ({"lag_s": 40.0}, "calibration.latency", "the latency is 40 s"),
    ],
)
def test_files_that_disagree_are_refused_as_a_replay_refuses_them(
    changes: dict[str, Any], key: str, expected: str
) -> None:
    of, setup = ready(LiveConfig(ecg=EcgFieldConfig(rate_hz=250.0))).files, toy_setup()
    held = setup.calibrations
    given = {"probe": held.probe_from_image, "lag_s": held.lag_s, "tip": held.tip}
    fits = of.with_model(setup.heart.model)
    assert require_live_fit(fits.with_calibrations(**given)) == ()
    with pytest.raises(DvfIgError, match=expected) as refused:
        require_live_fit(fits.with_calibrations(**{**given, **changes}))
    assert refused.value.key == key


def test_what_is_doubtful_is_warned_of_as_a_replay_warns() -> None:
    of, setup = ready(LiveConfig(ecg=EcgFieldConfig(rate_hz=250.0))).files, toy_setup()
    held, near = setup.calibrations, Points("tool", np.array([[0.0, 0.0, 1.5]]))
    files = of.with_model(setup.heart.model)
    (found,) = require_live_fit(files.with_calibrations(held.probe_from_image, held.lag_s, near))
    assert found.key == "calibration.tip"
    assert "not calibrated in m" in found.sentence


@pytest.mark.usefixtures("toy_patient")
def test_other_machine_needs_allow() -> None:
    done = run("serve", "x", "--host", "192.0.2.7", "--seconds", 0.1)
    assert done.exit_code == 3
    assert "--allow 192.0.2.7" in done.stderr


def test_session_without_live_says_what_to_write(tmp_path: Path) -> None:
    file = tmp_path / "session.yaml"
    file.write_text("schema: dvf_ig.session/1\npreop: {model: heart.npz}\n")
    with pytest.raises(UnreadableFileError, match="live"):
        read_session(file, "live")
    done = run("serve", file)
    assert done.exit_code == 3
    assert "ecg: {field" in done.stderr


def test_breathing_without_a_sender_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "session.yaml"
    file.write_text(
        "schema: dvf_ig.session/1\npreop: {model: heart.npz}\nlive: {ecg: {field: EcgData, rate_hz: 500}}\n"
        "calibration: {probe: probe.json, latency: 0.05, tip: tip.json}\n"
        "respiration: {file: 'csv:ventilator.csv#pressure'}\n"
    )
    done = run("serve", file)
    assert done.exit_code == 3
    assert "state live.respiration (a marker, a field or an LSL stream)" in done.stderr


@pytest.mark.parametrize(
    ("columns", "device", "content"),
    [(1, BREATH, Text("0.25")), (3, CHEST, Transform(np.eye(4)))],
)
def test_breathing_of_a_recording_is_streamed_as_serve_takes_it(
    scenario: Scenario, columns: int, device: str, content: object
) -> None:
    values = np.full((40, columns), 0.25) * (columns == 1)
    breath = Respiration(np.arange(40) * 0.02, values, "pressure")
    sent = [m for _, m in messages_of(replace(scenario, respiration=breath), 1000.0) if m.device == device]
    assert len(sent) == 40
    assert type(sent[0].content) is type(content)
    assert str(sent[0].content) == str(content)
    assert sent[1].stamp_s == pytest.approx(1000.02)
    name = "marker:c.igs.mha" if columns == 3 else "csv:v.csv#p"
    config = SimpleNamespace(respiration=SimpleNamespace(file=name))
    live = LiveConfig(ecg=EcgFieldConfig(rate_hz=250.0), respiration=streamed_breath(cast("Any", config)))
    names, field = device_names(live), live.respiration
    assert (names.chest, getattr(field, "field", None)) == ((CHEST, None) if columns == 3 else (None, BREATH))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("live: {ecg: {field: EcgData, rate_hz: 500}, prob: x}", "unknown key prob"),
        ("live: {ecg: {lsl: x}}", "rate_hz"),
        ("live: {port: 70000, ecg: {rate_hz: 500}}", "port"),
        ("live: {probe: P}", "ecg"),
        ("live: {image_orientation: XX, ecg: {rate_hz: 500}}", "image_orientation"),
    ],
)
def test_live_section_that_is_wrong_names_its_key(tmp_path: Path, line: str, expected: str) -> None:
    file = tmp_path / "session.yaml"
    file.write_text(
        "schema: dvf_ig.session/1\npreop: {model: heart.npz}\n"
        f"calibration: {{probe: probe.json, latency: 0.05, tip: tip.json}}\n{line}\n"
    )
    with pytest.raises(UnreadableFileError, match=expected):
        read_session(file, "live")


@pytest.mark.parametrize(
    ("calibrated", "of_live", "flips", "sentence"),
    [
        ("MF", {}, (), None),
        ("MFA", {"image_orientation": "UF"}, (1,), None),
        (
            "MF",
            {"calibrated_orientation": "UF"},
            (),
            "calibrated_orientation is UF, but .*probe.json.* in MF",
        ),
        (None, {}, (), None),
        (None, {"image_orientation": "UN", "calibrated_orientation": "UF"}, (0,), None),
        (None, {"image_orientation": "UN"}, (), "images come in UN .* probe.json does not state"),
    ],
)
def test_live_images_are_turned_to_those_of_the_calibration_or_refused(
    tmp_path: Path,
    calibrated: str | None,
    of_live: dict[str, str],
    flips: tuple[int, ...],
    sentence: str | None,
) -> None:
    verdict = {"kind": "probe", "refused": False, "refused_because": [], "sensor_frame": "probe"}
    verdict |= {"sensor_from_image": np.diag([0.1, 0.1, 1, 1]), "image_orientation": calibrated}
    write_json(tmp_path / "probe.json", verdict)
    live = LiveConfig.model_validate({"ecg": {"rate_hz": 500}, **of_live})
    if sentence is not None:
        with pytest.raises(InvalidInputError, match=sentence) as refused:
            require_orientation(live, "probe.json", tmp_path)
        assert refused.value.key == "live.calibrated_orientation"
    else:
        require_orientation(live, "probe.json", tmp_path)
        assert device_names(live).flips == flips


def test_kinds_of_ecg_are_told_apart() -> None:
    from dvf_ig.intake.live import LiveConfig

    assert isinstance(LiveConfig.model_validate({"ecg": {"rate_hz": 500}}).ecg, EcgFieldConfig)
    assert isinstance(
        LiveConfig.model_validate({"ecg": {"tail": "x.csv", "rate_hz": 500}}).ecg, EcgTailConfig
    )


@pytest.mark.usefixtures("toy_patient")
@pytest.mark.usefixtures("blank_pictures")
def test_serve_drives_a_simulated_device_and_says_how_its_force_ended() -> None:
    """The hand follows the poses of the tool that are sent; without a registration there is no force."""
    with sending(TOOL) as port:
        done = run("serve", "x", "--port", port, "--device", "simulated:omni", "--seconds", 2.0, "--json")
    assert done.exit_code == 0, done.stderr
    assert "simulated PHANToM Omni gives no force: the session has ended" in done.stderr
    result = json.loads(done.stdout)
    device = result["device"]
    assert device["ticks"] > 0
    assert device["largest_force_n"] == 0.0
    assert device["ended"] == "the session has ended"
    assert result["answers"] > 0


@pytest.mark.usefixtures("toy_patient")
def test_serve_refuses_a_device_that_is_missing_before_anything_is_connected() -> None:
    done = run("serve", "x", "--device", "openhaptics", "--seconds", 0.1)
    assert done.exit_code == 3
    assert "install OpenHaptics" in done.stderr
