"""What a replay leaves for other programs: the same numbers, in files that are never half-written."""

import csv
import hashlib
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from typer.testing import CliRunner, Result

from dvf_ig.cardiac.respiration import BreathState
from dvf_ig.cli.main import app
from dvf_ig.core import OutputError, PhaseTrack, Rigid, UnreadableFileError, Warp
from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.io import output_folder
from dvf_ig.io.provenance import recorded_inputs
from dvf_ig.io.writing.listing import LISTING
from dvf_ig.replay import Replay, validate
from dvf_ig.replay.outputs import COLUMNS, NAMES, SHAPE, read_shape, ticks_csv, write_outputs, write_shape
from dvf_ig.replay.ticks import Ticks
from dvf_ig.session import UNFOLLOWED

OF_UNCHANGED = tuple(name for name in NAMES if name != SHAPE)
WARP = Warp.through(
    "mr", np.full(3, -60.0), 10.0, np.random.default_rng(1).normal(size=(2197, 3)), np.ones(2197)
)
POSE = Rigid.from_rotation_vector([0.4, -0.9, 0.3], [12.5, -40.25, 310.75], "mr", "tracker")


def two_ticks() -> Ticks:
    """One without anything, one with everything."""
    nan = np.nan
    return Ticks(
        phase=PhaseTrack(
            np.array([0.001, 0.002]), np.array([0.0, 0.9999999]), np.zeros(2), np.array([nan, 0.85]), [0, 1]
        ),
        model_phase=np.array([nan, 0.5]),
        mr_from_tracker=np.stack([np.full((3, 4), nan), POSE.matrix[:3]]),
        pose_age_s=np.array([np.inf, 0.25]),
        pose_bound_mm=np.array([np.nan, 3.5]),
        tip_tracker_mm=np.array([[nan] * 3, [10.0, 20.0, 30.0]]),
        force_n=np.array([[0.0, 0.0, 0.0], [0.1, -0.2, 0.3]]),
        wanted_n=np.zeros((2, 3)),
        distance_mm=np.array([nan, 1.25]),
        margin_mm=np.zeros(2),
        breath_phase=np.array([nan, 0.25]),
        breath_mm=np.array([nan, 4.5]),
        breath_state=np.array([UNFOLLOWED, BreathState.LOCKED]),
        status=np.array([Status.NO_POSE, Status.OK]),
        supervisor=np.array([SupervisorState.FADE, SupervisorState.OK]),
        hazards=np.array([Hazard.NO_POSE | Hazard.NO_PHASE, 0]),
    )


def test_the_table_holds_what_the_ticks_hold() -> None:
    first, second = csv.DictReader(io.StringIO(ticks_csv(two_ticks())))
    assert list(first) == [name for name, _ in COLUMNS]
    assert {name: value for name, value in first.items() if value} == {
        "t_s": "0.001000",
        "phi": "0.000000",
        "phase_valid": "0",
        "force_tracker_x_n": "0.000000",
        "force_tracker_y_n": "0.000000",
        "force_tracker_z_n": "0.000000",
        "status": "no_pose",
        "supervisor": "fade",
        "hazards": "no_phase|no_pose",
        "margin_mm": "0.0000",
    }
    tip_mr = POSE.rotation @ (10, 20, 30) + POSE.translation_mm
    assert [float(second[f"tip_mr_{axis}_mm"]) for axis in "xyz"] == pytest.approx(tip_mr, abs=5.1e-5)
    assert [float(second[f"tip_tracker_{axis}_mm"]) for axis in "xyz"] == [10, 20, 30]
    assert [float(second[f"force_tracker_{axis}_n"]) for axis in "xyz"] == [0.1, -0.2, 0.3]
    assert (second["phi"], second["phase_valid"], second["distance_mm"]) == ("0.999999", "1", "1.2500")
    assert (second["status"], second["supervisor"], second["hazards"]) == ("ok", "ok", "")
    breath = (second["breath_phase"], second["breath_mm"], second["breath_state"])
    assert breath == ("0.250000", "4.5000", "locked")
    assert (second["model_phase"], second["rr_s"], second["pose_age_s"]) == ("0.500000", "0.850000", "0.250")


def test_no_word_of_the_table_is_taken_for_a_missing_number() -> None:
    names = [one.name.lower() for kind in (Status, SupervisorState, Hazard) for one in kind if one.name]
    assert not [name for name in [*names, *dict(COLUMNS)] if "nan" in name or "inf" in name]


def test_the_last_pose_in_use_is_the_one_that_is_written(tmp_path: Path) -> None:
    earlier = Rigid.identity("mr", "tracker")
    written = write_outputs([(1.0, earlier), (2.0, POSE)], two_ticks(), tmp_path, warp=WARP)
    assert set(written) == set(NAMES) == {path.name for path in tmp_path.iterdir()}
    for ending in ("tfm", "h5"):
        transform = SimpleITK.ReadTransform(str(tmp_path / f"mr_from_tracker.{ending}"))
        place = transform.TransformPoint((10.0, 20.0, 30.0))
        np.testing.assert_allclose(place, POSE.rotation @ (10, 20, 30) + POSE.translation_mm, atol=1e-9)
    assert (tmp_path / "poses.seq.mha").read_text().count("TrackerToRasTransform =") == 1
    with recorded_inputs():
        for _ in range(2):
            with output_folder(tmp_path / "again", NAMES):
                write_outputs([(2.0, POSE)], two_ticks(), tmp_path / "again")


def test_a_change_of_shape_is_read_as_it_was_written(tmp_path: Path) -> None:
    assert read_shape(tmp_path) is None
    write_shape(replace(WARP, contraction=0.62), tmp_path / SHAPE)
    read = read_shape(tmp_path)
    assert read is not None
    np.testing.assert_array_equal(read.coefficients, WARP.coefficients)
    np.testing.assert_array_equal(read.origin_mm, WARP.origin_mm)
    assert (read.frame, read.knot_mm, read.contraction) == ("mr", WARP.knot_mm, 0.62)
    content = json.loads((tmp_path / SHAPE).read_text())
    for name, value in (("coefficients", content["coefficients"][:-8]), ("knot_mm", 0.0), ("origin_mm", [1])):
        (tmp_path / SHAPE).write_text(json.dumps({**content, name: value}))
        with pytest.raises(UnreadableFileError, match="damaged"):
            read_shape(tmp_path)


def test_what_plus_reads_names_the_marker_that_poses_are_relative_to(tmp_path: Path) -> None:
    written = write_outputs([(2.0, POSE)], two_ticks(), tmp_path, "reference")
    assert 'From="Reference" To="Mr"' in (tmp_path / "mr_from_tracker.xml").read_text()
    assert "ReferenceToRasTransform =" in (tmp_path / "poses.seq.mha").read_text()
    assert written["mr_from_tracker.tfm"] == "mr_from_tracker"


def test_without_a_pose_there_is_no_file_of_one(tmp_path: Path) -> None:
    ticks = two_ticks()
    without = replace(ticks, mr_from_tracker=np.full_like(ticks.mr_from_tracker, np.nan))
    assert list(write_outputs([], without, tmp_path)) == ["ticks.csv"]


@pytest.mark.parametrize("name", NAMES)
def test_a_users_own_file_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine, not yours")
    with (
        recorded_inputs(),
        pytest.raises(OutputError, match="this program did not write"),
        output_folder(tmp_path, NAMES),
    ):
        write_outputs([(2.0, POSE)], two_ticks(), tmp_path)
    assert (tmp_path / name).read_text() == "mine, not yours"
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.fixture
def replayed(replay: Replay, monkeypatch: pytest.MonkeyPatch) -> Replay:
    """The command's replay is the shared one, so that none has to be computed."""
    monkeypatch.setattr("dvf_ig.replay.run_replay", lambda *_, **__: replay)
    return replay


def test_the_command_writes_all_files_and_says_what_it_read(
    replay: Replay, written: Path, commanded: tuple[Path, Result]
) -> None:
    out, done = commanded
    assert {path.name for path in out.iterdir()} - {LISTING} == {
        "result.json",
        "report.html",
        "shape.json",
        "view.json",
        *OF_UNCHANGED,
    }
    for name in ("result.json", "report.html", "view.json", *OF_UNCHANGED):
        assert f"wrote {out / name}" in done.stderr
    result = json.loads((out / "result.json").read_text())
    validate(result)
    assert result == json.loads(done.stdout)
    listed = {one["file"]: one for one in result["inputs"]}
    files = {p.relative_to(written).as_posix(): p for p in written.rglob("*") if p.is_file()}
    del files[LISTING]
    assert listed.keys() == files.keys()
    for name, one in listed.items():
        data = files[name].read_bytes()
        assert (one["sha256"], one["bytes"]) == (hashlib.sha256(data).hexdigest(), len(data))
    np.testing.assert_array_equal(
        np.array(result["estimates"]["mr_from_tracker"]), replay.poses[-1][1].matrix
    )
    transform = SimpleITK.ReadTransform(str(out / "mr_from_tracker.tfm"))
    np.testing.assert_allclose(
        transform.TransformPoint((0.0, 0.0, 0.0)), replay.poses[-1][1].translation_mm, atol=1e-9
    )
    assert len((out / "ticks.csv").read_text().splitlines()) == len(replay.ticks) + 1


def test_nothing_is_left_half_written(
    replayed: Replay, written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    out.mkdir()
    (out / "ticks.csv").write_text("mine")
    done = CliRunner().invoke(app, ["replay", str(written), "-o", str(out)])
    assert done.exit_code == 4
    assert [path.name for path in out.iterdir()] == ["ticks.csv"]
    (out / "ticks.csv").unlink()

    def full(*_: object) -> None:
        raise OutputError("no space left")

    monkeypatch.setattr("dvf_ig.replay.outputs.write_pose_sequence", full)
    (out / "result.json").write_text("of an earlier run")
    done = CliRunner().invoke(app, ["replay", str(written), "-o", str(out)])
    assert done.exit_code == 4
    assert {path.name: path.read_text() for path in out.iterdir()} == {"result.json": "of an earlier run"}
