"""The commands as a user types them: help without heavy imports, doctor, register, evaluate, replay."""

import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from html_outline import outline_of
from scipy.spatial.transform import Rotation
from typer.main import get_command
from typer.testing import CliRunner
from waiting import heed_interrupts

import dvf_ig
from dvf_ig.cli import main
from dvf_ig.cli.doctor import verdict
from dvf_ig.cli.examples import EXAMPLES, SECTIONS
from dvf_ig.cli.main import app
from dvf_ig.cli.shell import time_left
from dvf_ig.core import DvfModel, Landmarks, Points, Preop, Rigid, Scenario
from dvf_ig.intake.model_cache import SUFFIX
from dvf_ig.io import read_coordinate_definitions, read_transform, write_landmarks, write_transform
from dvf_ig.registration import RegistrationResult, target_errors_mm
from dvf_ig.replay import Replay
from dvf_ig.replay.registration import PreparedRegistration
from dvf_ig.session.heart import Heart


def run(*arguments: str) -> dict[str, object]:
    """The JSON that a successful command prints."""
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    loaded: dict[str, object] = json.loads(result.stdout)
    return loaded


@pytest.mark.parametrize("words", [["--help"], ["study", "--help"]])
def test_help_loads_nothing_heavy(words: list[str]) -> None:
    code = (
        "import sys; from typer.testing import CliRunner; from dvf_ig.cli.main import app;"
        f"r = CliRunner().invoke(app, {words}); assert r.exit_code == 0;"
        "heavy = {'numpy', 'scipy', 'numba', 'SimpleITK', 'open3d', 'cv2', 'matplotlib'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("given", "used"), [(None, "1"), ("3", "3")])
def test_blas_has_one_thread_unless_the_user_says_otherwise(
    given: str | None, used: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", given or "")
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    monkeypatch.setattr(sys, "argv", ["dvf-ig", "--version"])
    with pytest.raises(SystemExit, match="0"):
        main.run()
    assert os.environ["OPENBLAS_NUM_THREADS"] == used


def _commands(group: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    for name, found in group.commands.items():
        if hasattr(found, "commands"):
            yield from _commands(found, f"{before}{name} ")
        else:
            yield f"{before}{name}", found


def test_every_example_is_a_command_that_parses() -> None:
    commands = dict(_commands(get_command(app)))
    assert {name for name in commands if not name.startswith("study ")} == set(EXAMPLES)
    for name, found in commands.items():
        examples = [line for line in found.epilog.splitlines() if line.startswith("dvf-ig")]
        assert examples, name
        for example in examples:
            assert example.startswith(f"dvf-ig {name}")
            arguments = shlex.split(example)[1 + len(name.split()) :]
            commands[name].make_context(name, arguments)


@pytest.mark.parametrize(
    ("missing", "optional", "start"),
    [(0, 0, "ready:"), (0, 2, "ready; 2 things"), (1, 0, "not ready: 1 thing")],
)
def test_doctor_ends_in_a_verdict(missing: int, optional: int, start: str) -> None:
    assert verdict(missing, optional).startswith(start)


def test_module_and_version() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dvf_ig", "--version"], check=True, capture_output=True, text=True
    )
    assert done.stdout.strip() == f"dvf-ig {dvf_ig.__version__}"


def test_doctor_names_what_is_needed() -> None:
    payload = run("doctor")
    assert payload["ok"] is True
    assert str(payload["verdict"]).startswith("ready")
    names = {check["what"] for check in payload["checks"]}  # type: ignore[attr-defined]
    assert {"package numba", "package SimpleITK", "system library libusb-1.0-0"} <= names


def test_doctor_names_the_folder_of_compiled_kernels(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dvf_ig", "doctor"],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        check=True,
        capture_output=True,
        text=True,
    )
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("folder of compiled kernels"))
    assert Path(line.split()[-1]).parent == tmp_path


def test_doctor_says_what_to_do_where_kernels_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dvf_ig.kernels.compiled.cache_folder", lambda: None)
    payload = run("doctor")
    assert payload["ok"] is True
    (check,) = (c for c in payload["checks"] if c["what"] == "folder of compiled kernels")  # type: ignore[attr-defined]
    assert check["found"] is None
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in check["remedy"]


@pytest.mark.usefixtures("drawn")
def test_register_writes_a_transform_that_evaluate_reads(
    scenario: Scenario,
    replay: Replay,
    registered: RegistrationResult,
    written: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The result is the shared one; test_own_recordings registers what is read from files."""

    def heart_of_the_same_images(preop: Preop, _: DvfModel | None, **__: object) -> Heart:
        """The replay's: what was read back is what it was built from, and building it again takes long."""
        for read, made in ((preop.mr, scenario.preop.mr), (preop.labels, scenario.preop.labels)):
            assert read is not None
            assert made is not None
            np.testing.assert_array_equal(read.values, made.values)
            np.testing.assert_allclose(read.grid.to_mm(np.eye(3)), made.grid.to_mm(np.eye(3)), atol=1e-9)
            np.testing.assert_allclose(read.timing.fractions, made.timing.fractions, atol=1e-9)
        assert preop.organ_labels == scenario.preop.organ_labels
        assert preop.label_names == scenario.preop.label_names
        assert preop.patient_id == scenario.preop.patient_id
        return replay.heart

    monkeypatch.setattr("dvf_ig.replay.engine.build_heart", heart_of_the_same_images)
    monkeypatch.setattr(PreparedRegistration, "register", lambda *_, **__: registered)
    out = tmp_path / "registered"
    payload = run("register", str(written), "-o", str(out))
    assert payload["stop"] == "CONVERGED"
    assert np.shape(payload["covariance"]) == (6, 6)
    assert {"success_probability", "seconds", "threads", "seed"} <= set(payload)
    estimate = read_transform(out / "mr_from_tracker.tfm")
    np.testing.assert_allclose(estimate.matrix, payload["mr_from_tracker"], atol=1e-9)
    page = outline_of((out / "report.html").read_text(encoding="utf-8"))
    assert page.faults == []
    pictures = 4 * 5 + (registered.shape is not None)
    assert len(page.images) == len({image["src"] for image in page.images}) == pictures
    said = " ".join(page.texts)
    assert "This registration may be used" in said
    assert f"{payload['moved_mm']:.1f} mm" in said
    assert scenario.truth is not None
    truth = scenario.truth.mr_from_tracker_at(0.0)
    assert np.median(target_errors_mm(estimate, truth, scenario.truth.targets.points)) < 2.0

    write_transform(truth, tmp_path / "truth.tfm")
    touched = truth.inverse().apply(scenario.truth.targets.points)
    write_landmarks(Landmarks(scenario.truth.targets.names, touched), tmp_path / "fixed.mrk.json")
    write_landmarks(scenario.truth.targets, tmp_path / "moving.mrk.json")
    against_truth = run(
        "evaluate",
        "--transform",
        str(out),
        "--landmarks",
        str(tmp_path / "fixed.mrk.json"),
        "--truth",
        str(tmp_path / "truth.tfm"),
    )
    against_points = run(
        "evaluate",
        "--transform",
        str(out),
        "--landmarks",
        str(tmp_path / "fixed.mrk.json"),
        str(tmp_path / "moving.mrk.json"),
    )
    assert against_truth["tre_mm"] == pytest.approx(against_points["tre_mm"], abs=1e-6)
    assert against_points["rotation_deg"] is None
    assert against_truth["rotation_deg"] == pytest.approx(
        np.degrees((estimate @ truth.inverse()).angle_rad), abs=1e-6
    )


def test_evaluate_of_a_known_shift(tmp_path: Path) -> None:
    truth = Rigid.from_rotation_vector([0.1, 0.2, 0.3], [10, 20, 30], "mr", "tracker")
    shifted = Rigid("mr", "tracker", truth.rotation, truth.translation_mm + np.array([3.0, 0.0, 4.0]))
    write_transform(shifted, tmp_path / "estimate.tfm")
    write_transform(truth, tmp_path / "truth.tfm")
    points = Landmarks(("a", "b"), Points("tracker", np.array([[0.0, 0, 0], [50, 60, 70]])))
    write_landmarks(points, tmp_path / "points.mrk.json")
    result = run(
        "evaluate",
        "--transform",
        str(tmp_path / "estimate.tfm"),
        "--landmarks",
        str(tmp_path / "points.mrk.json"),
        "--truth",
        str(tmp_path / "truth.tfm"),
    )
    assert result["tre_mm"]["max"] == pytest.approx(5.0, abs=1e-6)  # type: ignore[index]
    np.testing.assert_allclose(result["translation_mm"], [3, 0, 4], atol=1e-6)


def pose_table(path: Path, poses: list[Rigid]) -> Path:
    """Poses as rows x y z qx qy qz qw."""
    turns = Rotation.from_matrix(np.stack([pose.rotation for pose in poses])).as_quat()
    np.savetxt(path, np.column_stack([np.stack([pose.translation_mm for pose in poses]), turns]))
    return path


def test_hand_eye_writes_json_xml_and_a_picture(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    mounted = Rigid.from_rotation_vector([0.4, -1.1, 0.2], [12, -30, 55], "hand", "camera")
    placed = Rigid.from_rotation_vector([0.3, 0.2, -0.8], [400, 100, 20], "base", "target")
    seen = [
        Rigid.from_rotation_vector(
            rng.uniform(-0.6, 0.6, 3), np.array([0, 0, 300]) + rng.uniform(-50, 50, 3), "camera", "target"
        )
        for _ in range(15)
    ]
    held = [placed @ view.inverse() @ mounted.inverse() for view in seen]
    robot, camera = pose_table(tmp_path / "robot.txt", held), pose_table(tmp_path / "camera.txt", seen)
    out = tmp_path / "mounted.json"
    result = run("calibrate", "hand-eye", str(robot), str(camera), "-o", str(out))
    np.testing.assert_allclose(result["hand_from_camera"], mounted.matrix, atol=1e-4)
    assert result["pairs"] == result["inliers"] == 15
    assert (result["target"], result["source"]) == ("hand", "camera")
    written = read_coordinate_definitions(out.with_suffix(".xml"))["hand_from_camera"]
    assert written.tolist() == result["hand_from_camera"]
    assert out.with_suffix(".png").read_bytes()[:4] == b"\x89PNG"
    refused = CliRunner().invoke(
        app, ["calibrate", "hand-eye", str(robot), str(camera), "--method", "kabsch"]
    )
    assert refused.exit_code == 3
    still = pose_table(tmp_path / "still.txt", [held[0]] * 15)
    assert CliRunner().invoke(app, ["calibrate", "hand-eye", str(still), str(camera)]).exit_code == 7


def test_landmarks_are_compared_with_a_stated_placement(data_dir: Path, tmp_path: Path) -> None:
    folder = data_dir / "plus-phantom-landmarks"
    result = run(
        "calibrate", "landmarks", str(folder / "EightLandmarkPointsTrackedForPhantomRegistration.igs.mha"),
        "--device-set", str(folder / "PlusDeviceSet_fCal_Sim_RecordPhantomLandmarks.xml"),
        "--compare", str(folder / "PhantomRegistrationLandmarkDetection.results.xml"),
        "-o", str(tmp_path / "placed.json"),
    )  # fmt: skip
    assert result["mean_mm"] <= 0.30  # type: ignore[operator]
    assert result["ambiguous"] is False
    difference = result["difference"]
    assert difference["rotation_deg"] < 0.1  # type: ignore[index]
    assert difference["centroid_mm"] < 0.25  # type: ignore[index]
    assert (tmp_path / "placed.png").is_file()
    # what was written is a placement to compare with
    again = run(
        "calibrate", "landmarks", str(folder / "EightLandmarkPointsTrackedForPhantomRegistration.igs.mha"),
        "--device-set", str(folder / "PlusDeviceSet_fCal_Sim_RecordPhantomLandmarks.xml"),
        "--compare", str(tmp_path / "placed.xml"),
    )  # fmt: skip
    assert again["difference"]["largest_mm"] < 1e-9  # type: ignore[index]


def test_latency_draws_its_evidence(data_dir: Path, tmp_path: Path) -> None:
    folder = data_dir / "plus-temporal-watertank"
    out = tmp_path / "lag.json"
    result = run(
        "calibrate", "latency", str(folder / "WaterTankBottomTranslationTrackerBuffer-trimmed.igs.mha"),
        str(folder / "WaterTankBottomTranslationVideoBuffer.igs.mha"),
        "--line-table", str(folder / "LineSegmentationResultsBaseline.xml"), "-o", str(out),
    )  # fmt: skip
    assert result["lag_s"] == pytest.approx(-0.0648, abs=0.002)
    assert result["second_sigmas"] > 3.0  # type: ignore[operator]
    assert len(result["period_lags_s"]) == 17
    assert out.with_suffix(".png").is_file()
    assert not out.with_suffix(".xml").exists()


@pytest.mark.parametrize(
    ("words", "kind", "code"),
    [
        (["replay", "/nowhere", "-o", "RUN"], "UnreadableFile", 3),
        (["replay", "demo", "--tool", "x"], "Usage", 2),
        (["force", "demo"], "Usage", 2),
    ],
)
def test_an_error_is_json_under_json(words: list[str], kind: str, code: int, tmp_path: Path) -> None:
    given = [str(tmp_path / "run") if word == "RUN" else word for word in words]
    result = CliRunner().invoke(app, [*given, "--json"])
    error = json.loads(result.stdout)["error"]
    assert (error["kind"], error["exit_code"], result.exit_code) == (kind, code, code)
    assert error["message"].split()[0] in result.stderr
    assert CliRunner().invoke(app, given).stdout == ""


def test_groups_have_examples_and_the_program_has_sections() -> None:
    program = CliRunner().invoke(app, ["--help"]).stdout
    assert "dvf-ig view run" in program
    assert [heading for heading in SECTIONS if f"─ {heading} ─" in program] == list(SECTIONS)
    for group in ("calibrate", "model", "synth", "config", "export"):
        assert f"dvf-ig {group} " in CliRunner().invoke(app, [group, "--help"]).stdout


def test_the_cache_is_shown_and_cleared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DVF_IG_CACHE", str(tmp_path))
    (tmp_path / "models").mkdir()
    entry, other = tmp_path / "models" / f"key{SUFFIX}", tmp_path / "models" / "mine.txt"
    entry.write_bytes(bytes(2_000_000))
    other.write_text("not an entry")
    shown = run("cache")
    assert (shown["folder"], shown["models"], shown["megabytes"]) == (str(entry.parent), 1, 2.0)
    assert entry.exists()
    cleared = run("cache", "--clear")
    assert (cleared["models"], cleared["megabytes"], cleared["removed"]) == (0, 0.0, 1)
    assert not entry.exists()
    assert other.exists()


@pytest.mark.parametrize(
    ("elapsed_s", "fraction", "text"),
    [(3.0, 0.0, "3 s"), (10.0, 0.25, "30 s left"), (60.0, 0.1, "9 min left")],
)
def test_time_left_is_estimated_from_the_first_report(elapsed_s: float, fraction: float, text: str) -> None:
    assert time_left(elapsed_s, fraction) == text


def test_help_of_scripts_installs_nothing(tmp_path: Path) -> None:
    folder = Path(dvf_ig.__file__).parents[1] / "scripts"
    scripts = [path for path in folder.iterdir() if path.suffix == "" and path.is_file()]
    copies = tmp_path / "scripts"
    shutil.copytree(folder, copies)
    (copies / "setup").write_text("exit 1")
    for script in scripts:
        if script.name not in ("setup", "usage"):
            done = subprocess.run(["bash", copies / script.name, "--help"], capture_output=True, text=True)
            assert done.returncode == 0, script.name
            assert done.stdout.splitlines()[0] == script.read_text().splitlines()[1].removeprefix("# ")


def test_ctrl_c_does_not_wait_for_threads() -> None:
    code = (
        "import os, signal, sys, threading, time\n"
        "from dvf_ig.cli import main\n"
        "from dvf_ig.core.progress import thread_pool\n"
        "def work():\n"
        "    with thread_pool(2) as pool:\n"
        "        waited_for = pool.map(time.sleep, [3600.0, 3600.0, 3600.0])\n"
        "        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
        "        list(waited_for)\n"
        "main.app.registered_commands[0].callback = work\n"
        "sys.argv = ['dvf-ig', str(main.app.registered_commands[0].name)]\n"
        "main.run()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=900,
        preexec_fn=heed_interrupts,
    )
    assert done.returncode == main.INTERRUPTED
    assert done.stderr.strip() == "interrupted"
