"""What `inspect` says of sequences and PLUS files: clocks, validity, frame trees, image maps."""

import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import DvfIgError, Mesh, PoseStream, Rigid, TrackedSequence, UnreadableFileError
from dvf_ig.intake import describe
from dvf_ig.intake.describe.sequence import clock_facts, frame_tree
from dvf_ig.io import (
    read_ecg,
    read_image_map,
    write_coordinate_definitions,
    write_json,
    write_mesh,
    write_poses,
    write_sequence,
    write_transform,
)


def shown(path: Path) -> str:
    done = CliRunner().invoke(app, ["inspect", str(path)])
    assert done.exit_code == 0, done.output
    return done.stdout


def sequence(path: Path) -> Path:
    """20 frames at 10 Hz without frame 12; the probe is lost for three of them and frozen for six."""
    t_s = np.delete(np.arange(21) / 10.0, 12)
    turns = np.tile(np.eye(3), (20, 1, 1))
    shifts = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])
    shifts[10:16] = shifts[10]
    valid = np.ones(20, bool)
    valid[:3] = False
    streams = [
        PoseStream("tracker", "probe", t_s, turns, shifts, valid),
        PoseStream("tracker", "reference", t_s, turns, 0 * shifts, np.ones(20, bool)),
    ]
    images = np.zeros((20, 4, 6), np.uint8)
    write_sequence(TrackedSequence(t_s, images, np.arange(20) > 0, {s.name: s for s in streams}), path)
    return path


def test_facts_of_a_sequence(tmp_path: Path) -> None:
    facts = describe(str(sequence(tmp_path / "s.igs.mha"))).facts
    assert facts["image_size_px"] == [6, 4]
    assert facts["invalid_image_share"] == pytest.approx(1 / 20)
    assert facts["rate_hz"] == pytest.approx(10.0)
    assert facts["jitter_s"] == pytest.approx(0.0, abs=1e-9)
    assert facts["missing_frames"] == 1
    assert facts["longest_gap_s"] == pytest.approx(0.2)
    assert facts["transforms"]["tracker_from_probe"]["invalid_share"] == pytest.approx(3 / 20)
    assert facts["transforms"]["tracker_from_probe"]["frozen_share"] == pytest.approx(6 / 17)
    assert (facts["repeated_stamps"], facts["backward_stamps"]) == (0, 0)
    assert facts["frame_tree"] == ["tracker", "├─ probe", "└─ reference"]


def test_a_sequence_as_text(tmp_path: Path) -> None:
    text = shown(sequence(tmp_path / "s.igs.mha"))
    assert "10.00 frames/s for 2.00 s from 0.000 s" in text
    assert "1 frames missing" in text
    assert (
        "├─ probe      tracker_from_probe: 15.0% INVALID, frozen for 35%, moves 16.0 x 0.0 x 0.0 mm" in text
    )
    assert "6 x 4 px, orientation MFA, 5.0% INVALID" in text


def test_a_restarted_clock_is_told_once_and_in_the_facts(tmp_path: Path) -> None:
    path = tmp_path / "s.igs.mha"
    turns = np.tile(np.eye(3), (5, 1, 1))
    first, second = (
        PoseStream("tracker", "tool", t_s, turns, np.ones((5, 3)), np.ones(5, bool))
        for t_s in (np.arange(5) / 10.0, np.arange(5) / 10.0 - 0.3)
    )
    write_poses(first, path, second)
    facts = describe(str(path)).facts
    assert facts["frames"] == 5
    assert facts["clock_restart"] == {
        "frame": 5,
        "at_s": pytest.approx(-0.3),
        "back_s": pytest.approx(0.7),
        "unused_frames": 5,
    }
    done = CliRunner().invoke(app, ["inspect", str(path)])
    row = "jumps back by 0.700 s at frame 5: the 5 frames from there on are not used"
    assert row in done.stdout
    assert done.stderr.count("note: ") == 1
    assert "split the file there, or record again" in done.stderr
    assert describe(str(sequence(path))).facts["clock_restart"] is None


def test_frame_tree_of_several_groups_and_rings() -> None:
    edges = [("tracker", "probe"), ("probe", "image"), ("tracker", "stylus"), ("stylus", "stylus_tip")]
    assert frame_tree([*edges, ("room", "table")]) == [
        "tracker",
        "├─ probe",
        "│  └─ image",
        "└─ stylus",
        "   └─ stylus_tip",
        "room",
        "└─ table",
    ]
    ring = frame_tree([("a", "b"), ("b", "c"), ("c", "a")])
    assert sorted(line.lstrip("│├└─ ") for line in ring) == ["a", "b", "c"]
    assert frame_tree([]) == []


def test_clock_of_one_stamp_and_of_jitter() -> None:
    assert clock_facts(np.array([3.0]))["rate_hz"] is None
    rng = np.random.default_rng(0)
    t_s = np.arange(2000) * 0.05 + 0.002 * rng.standard_normal(2000)
    # a step is the difference of two stamps: its SD is √2 of theirs
    assert clock_facts(t_s)["jitter_s"] == pytest.approx(0.002 * np.sqrt(2), rel=0.06)


def test_pixels_that_are_not_b_mode_are_described_all_the_same(tmp_path: Path) -> None:
    image = SimpleITK.GetImageFromArray(np.zeros((3, 5, 7), np.int16))
    for i in range(3):
        image.SetMetaData(f"Seq_Frame{i:04d}_Timestamp", str(i / 10))
        image.SetMetaData(f"Seq_Frame{i:04d}_ProbeToTrackerTransform", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1")
        image.SetMetaData(f"Seq_Frame{i:04d}_ImageToProbeTransform", ".1 0 0 0 0 .1 0 0 0 0 .1 0 0 0 0 1")
    path = tmp_path / "rf.igs.mha"
    SimpleITK.WriteImage(image, str(path))
    facts = describe(str(path)).facts
    assert facts["image_size_px"] == [7, 5]
    assert facts["pixel_type"] == "MET_SHORT"
    assert facts["image_maps"] == ["probe_from_image"]
    text = shown(path)
    assert "probe_from_image: a map from pixels, not a pose" in text
    assert "pixels MET_SHORT" in text


def test_every_real_sequence_is_described(data_dir: Path) -> None:
    paths = [p for p in sorted(data_dir.glob("plus-*/*.igs.m*")) if p.stat().st_size < 2_600_000]
    assert len(paths) >= 10
    for path in paths:
        lines = shown(path).splitlines()
        assert lines[2].startswith("frames")
        assert any(line.startswith("poses") for line in lines)
    video = describe(str(next(p for p in paths if "VideoBuffer" in p.name))).facts
    assert video["stamp_filter_shift_s"] == pytest.approx(0.0703, abs=0.002)
    assert video["missing_frames"] == 2


def test_a_plus_image_calibration_is_made_orthogonal(data_dir: Path) -> None:
    path = data_dir / "plus-fcal20-nwire" / "FreehandCalibration3NWires_fCal2.0.results.xml"
    placed = read_image_map(path)
    assert placed.shear_deg == pytest.approx(0.333, abs=0.001)
    assert np.abs(placed.rigid.rotation.T @ placed.rigid.rotation - np.eye(3)).max() < 1e-12
    assert np.allclose(placed.scale_mm_per_px, [0.0803289, 0.0744631], atol=1e-6)
    facts = describe(str(path)).facts["transforms"]["probe_from_image"]
    assert facts["shear_deg"] == pytest.approx(0.333, abs=0.001)
    with pytest.raises(UnreadableFileError, match="no transform stylus_from_image; it has probe_from_image"):
        read_image_map(path, "stylus")


def test_an_image_calibration_beyond_a_degree_is_refused_and_told(tmp_path: Path) -> None:
    path = tmp_path / "bad.xml"
    matrix = np.diag([0.1, 0.1, 0.1, 1.0])
    matrix[0, 1] = 0.1 * np.tan(np.radians(1.5))
    write_coordinate_definitions(path, {"probe_from_image": matrix})
    with pytest.raises(UnreadableFileError, match=r"1\.50° off orthogonal, needed at most 1"):
        read_image_map(path)
    assert "1.50° off orthogonal" in describe(str(path)).facts["transforms"]["probe_from_image"]["problem"]
    matrix[0, 1] = 0.1 * np.tan(np.radians(0.9))
    write_coordinate_definitions(path, {"probe_from_image": matrix})
    assert read_image_map(path).shear_deg == pytest.approx(0.9, abs=1e-6)


def test_json_of_a_real_sequence_keeps_its_names(data_dir: Path) -> None:
    path = data_dir / "plus-temporal-watertank" / "WaterTankBottomTranslationCombined.igs.mha"
    done = CliRunner().invoke(app, ["inspect", str(path), "--json"])
    facts = json.loads(done.stdout)
    assert {"frames", "rate_hz", "gaps", "longest_gap_s", "transforms", "orientation"} <= set(facts)
    assert facts["frame_tree"][0] == "tracker"


def test_annotated_beats_are_read_where_their_file_is_named(data_dir: Path, tmp_path: Path) -> None:
    for ending in ("hea", "dat", "atr"):
        (tmp_path / f"101.{ending}").write_bytes((data_dir / "mitdb-ds1" / f"101.{ending}").read_bytes())
    assert describe(str(tmp_path / "101.atr")).facts["annotated_beats"] > 1000
    assert "annotated_beats" not in describe(str(tmp_path / "101.dat")).facts
    (tmp_path / "101.atr").write_bytes((tmp_path / "101.atr").read_bytes()[:2000])
    with pytest.raises(UnreadableFileError, match="truncated"):
        describe(str(tmp_path / "101.atr"))


def test_foreign_transforms_have_a_matrix_and_no_frames(tmp_path: Path) -> None:
    euler = SimpleITK.Euler3DTransform((5.0, 6, 7), 0.0, 0.0, np.pi / 2, (1.0, 2, 3))
    affine = SimpleITK.AffineTransform(3)
    affine.Scale(1.1)
    for name in ("a.tfm", "a.h5", "a.txt"):
        SimpleITK.WriteTransform(euler, str(tmp_path / name))
        facts = describe(str(tmp_path / name)).facts
        assert facts["angle_deg"] == pytest.approx(90)
        np.testing.assert_allclose(np.array(facts["matrix"])[:3, 3], euler.TransformPoint((0.0, 0, 0)))
        assert (facts["name"], facts["frames"][:9]) == (None, "not known")
    SimpleITK.WriteTransform(affine, str(tmp_path / "b.tfm"))
    assert "not rigid" in shown(tmp_path / "b.tfm")
    write_transform(Rigid("mr", "tracker", np.eye(3), np.ones(3)), tmp_path / "c.tfm")
    assert describe(str(tmp_path / "c.tfm")).facts["name"] == "mr_from_tracker"


def test_results_sessions_runs_and_tables(tmp_path: Path) -> None:
    verdict = {"refused": False, "refused_because": []}
    tip = {**verdict, "kind": "tip", "tip_mm": [1, 2, 3], "tip_frame": "tool", "inputs": [{"file": "x"}]}
    (tmp_path / "run").mkdir()
    write_json(
        tmp_path / "run" / "result.json", {"tre_mm": {"mean": 1.5, "all": list(range(99))}, "ticks": 60000}
    )
    (tmp_path / "run" / "ticks.csv").write_text("t_s\n")
    write_json(tmp_path / "tip.json", tip)
    write_json(tmp_path / "bad.json", {**tip, "tip_mm": "near"})
    write_json(tmp_path / "other.json", {"a": 1})
    (tmp_path / "session.yaml").write_text("schema: dvf_ig.session/1\nultrasound: {file: b.mha}\n")
    (tmp_path / "t.csv").write_text("x,y,z\n1,2,3\n")
    (tmp_path / "p.csv").write_text("0;1,5;2;3;0;0;0;1\n1;2,5;2;3;0;0;0;1\n")
    assert "tip mm     (1, 2, 3)" in shown(tmp_path / "tip.json")
    run = describe(str(tmp_path / "run"))
    assert (run.kind, run.facts) == (
        "folder of a replay",
        {"tre_mm": {"mean": 1.5}, "ticks": 60000, "files": ["ticks.csv"]},
    )
    session = describe(str(tmp_path / "session.yaml"))
    assert (session.kind, session.facts["missing"]) == ("session", ["ultrasound.file"])
    assert describe(str(tmp_path)).kind == "folder of a session"
    assert describe(str(tmp_path / "t.csv")).kind == "points"
    assert describe(str(tmp_path / "p.csv")).facts["extent_mm"] == [1, 0, 0]
    with pytest.raises(UnreadableFileError, match=r"bad\.json"):
        describe(str(tmp_path / "bad.json"))
    with pytest.raises(UnreadableFileError, match="no JSON file that dvf-ig wrote"):
        describe(str(tmp_path / "other.json"))
    (tmp_path / "session.yaml").unlink()
    with pytest.raises(UnreadableFileError, match=r"a folder of no kind that can be read, with bad\.json"):
        describe(str(tmp_path))


def test_what_cannot_be_in_mm_or_s_has_a_row_that_says_so(tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [0.09, 0, 0], [0, 0.09, 0], [0, 0, 0.09]])
    write_mesh(
        Mesh("mr", corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])), tmp_path / "m.stl"
    )
    assert "the surface is 0.09 mm across" in shown(tmp_path / "m.stl")
    turns, moved = np.tile(np.eye(3), (12, 1, 1)), np.linspace(1.0, 1.2, 36).reshape(12, 3)
    poses = PoseStream("tracker", "tool", 50.0 * np.arange(12), turns, moved, np.ones(12, bool))
    write_poses(poses, tmp_path / "s.igs.mha")
    done = CliRunner().invoke(app, ["inspect", str(tmp_path / "s.igs.mha")])
    assert "every position of tracker_from_tool lies within 2.1 mm of the origin" in done.stdout
    assert "are in ms (then 20 a second)" in done.stderr


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("holter.ecg", b"ISHNE1.0...", "an ISHNE Holter recording; export it as EDF"),
        ("lab.acq", b"...", "an AcqKnowledge recording \\(BIOPAC\\); save it as EDF"),
        ("lab.adicht", b"...", "a LabChart recording; export it as text"),
        ("table.csv", b"0,1.5,2\n1,2.5,3\n5,6,7\n", "3 columns without names: points .* name the lead"),
    ],
)
def test_what_is_not_read_is_named_with_what_to_do(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UnreadableFileError, match=words):
        describe(str(tmp_path / name))
    if name != "table.csv":
        with pytest.raises(DvfIgError, match=words):
            read_ecg(str(tmp_path / name))
