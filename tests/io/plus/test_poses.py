"""Pose streams from sequences, folders and tables."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import InvalidInputError, PoseStream, TrackedSequence, UnreadableFileError
from dvf_ig.io import read_poses, read_sequence, tracked_probe, write_poses, write_sequence
from dvf_ig.io.plus.poses import recorded_poses


def stream(target: str, source: str, shift: float = 0.0, n: int = 4) -> PoseStream:
    rotations = Rotation.random(n, random_state=1).as_matrix()
    return PoseStream(target, source, np.arange(n) / 20, rotations, np.full((n, 3), shift), np.ones(n, bool))


def write(path: Path, *streams: PoseStream) -> Path:
    none = np.zeros(len(streams[0]), bool)
    write_sequence(TrackedSequence(streams[0].t_s, None, none, {s.name: s for s in streams}), path)
    return path


def test_real_tables(data_dir: Path) -> None:
    poses = read_poses(data_dir / "lsqrrecipes" / "pivotCalibrationData.txt")
    assert (poses.name, len(poses)) == ("tracker_from_tool", 481)
    published_tip = np.array([-17.7799, 1.1113, -156.865])
    pivot = poses.rotations @ published_tip + poses.translations_mm
    assert np.linalg.norm(pivot - (146.901, -62.9689, -1042.14), axis=1).max() < 2.5


def test_real_stylus_is_taken_against_the_reference(data_dir: Path) -> None:
    name = "EightLandmarkPointsTrackedForPhantomRegistration.igs.mha"
    assert read_poses(data_dir / "plus-phantom-landmarks" / name).name == "reference_from_stylus"


def test_the_only_tool(tmp_path: Path) -> None:
    path = write(tmp_path / "a.igs.mha", stream("tracker", "pointer"))
    assert read_poses(path).name == "tracker_from_pointer"


def test_choice_of_tool_and_frame(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.igs.mha",
        stream("tracker", "probe"),
        stream("tracker", "reference"),
        stream("tracker", "stylus"),
    )
    assert read_poses(path).name == "reference_from_stylus"
    assert read_poses(path, source="probe").name == "reference_from_probe"
    assert read_poses(path, "tracker", "probe").name == "tracker_from_probe"
    assert read_poses(path, "tracker").name == "tracker_from_stylus"


def test_ambiguous_tools_are_listed(tmp_path: Path) -> None:
    path = write(tmp_path / "a.igs.mha", stream("tracker", "clamp"), stream("tracker", "hook"))
    with pytest.raises(UnreadableFileError, match=r"\(tracker_from_clamp, tracker_from_hook\): name one"):
        read_poses(path)
    with pytest.raises(UnreadableFileError, match="does not track 'saw'"):
        read_poses(path, source="saw")


def test_folder_of_matrices_in_natural_order(tmp_path: Path) -> None:
    for i in range(11):
        matrix = np.eye(4)
        matrix[0, 3] = i
        np.savetxt(tmp_path / f"pose{i}.txt", matrix)
    poses = read_poses(tmp_path, "base", "hand")
    assert poses.name == "base_from_hand"
    assert poses.translations_mm[:, 0].tolist() == list(range(11))
    (tmp_path / "pose3.txt").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(UnreadableFileError, match=r"pose3\.txt holds 6 numbers"):
        read_poses(tmp_path)


def test_table_with_times_and_commas(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("# t x y z qx qy qz qw\n0.5, 1,2,3, 0,0,0.6,0.8\n0.75, 4,5,6, 0,0,0,1\n")
    poses = read_poses(tmp_path / "a.csv")
    assert poses.t_s.tolist() == [0.5, 0.75]
    np.testing.assert_allclose(
        poses.rotations[0], Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix(), atol=1e-15
    )


TABLES = {
    "names in another order, m and ms": "t_ms;qw;qx;qy;qz;x [m];y [m];z [m]\n500;1;0;0;0;0,1;0,2;0,3\n"
    "520;;;;;;;\n540;1;0;0;0;0,4;0,5;0,6\n",
    "NDI": "Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error\n1,0,0,0,100,200,300,0.1\nMISSING,,,,,,,\n1,0,0,0,400,500,600,0.1\n",
    "TUM comment": "# timestamp tx ty tz qx qy qz qw\n1 100 200 300 0 0 0 1\n2 nan nan nan nan nan nan nan\n"
    "3 400 500 600 0 0 0 1\n",
    "zeros where it was lost": "100 200 300 0 0 0 1\n0 0 0 0 0 0 0\n400 500 600 0 0 0 1\n",
    "origin and no turn where it was lost": "100 200 300 0 0 0 1\n0 0 0 0 0 0 1\n400 500 600 0 0 0 1\n",
    "one cell dropped": "100,200,300,0,0,0,1\n,200,300,0,0,0,1\n400,500,600,0,0,0,1\n",
}


@pytest.mark.parametrize("text", TABLES.values(), ids=list(TABLES))
def test_tables_as_trackers_write_them(tmp_path: Path, text: str, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "a.csv").write_text(text)
    with caplog.at_level(logging.WARNING, "dvf_ig.io"):
        poses = read_poses(tmp_path / "a.csv")
    assert poses.valid.tolist() == [True, False, True]
    np.testing.assert_allclose(poses.translations_mm[[0, 2]], [[100, 200, 300], [400, 500, 600]], rtol=1e-12)
    np.testing.assert_array_equal(poses.rotations[[0, 2]], np.tile(np.eye(3), (2, 1, 1)))
    assert "1 of 3 poses were lost" in caplog.text
    assert ("names no columns" in caplog.text) == text.startswith("100")
    assert ("columns error are not part of a pose" in caplog.text) == ("Error" in text)
    if "t_ms" in text:
        assert poses.t_s.tolist() == [0.5, 0.52, 0.54]


def test_a_sequence_in_metres_is_refused(tmp_path: Path) -> None:
    """Twelve poses between 1.1 and 1.3 m, stamped 50 s apart for 50 ms."""
    moved = np.column_stack([np.linspace(0.1, 0.3, 12), np.full(12, 0.2), np.full(12, -1.1)])
    turns, valid = np.tile(np.eye(3), (12, 1, 1)), np.ones(12, bool)
    path = write(tmp_path / "a.igs.mha", PoseStream("tracker", "probe", np.arange(12.0), turns, moved, valid))
    with pytest.raises(
        UnreadableFileError,
        match=r"every position of tracker_from_probe lies within 1\.2 mm .* are in m, not mm",
    ):
        read_poses(path)
    with pytest.raises(InvalidInputError, match="are in m, not mm"):
        tracked_probe(read_sequence(path))


@pytest.mark.parametrize("lost", [(1,), (0, 1, 2, 3)])
def test_poses_that_are_exactly_the_identity_are_lost(
    tmp_path: Path, lost: tuple[int, ...], caplog: pytest.LogCaptureFixture
) -> None:
    """A sequence whose status is OK, and a folder of matrices."""
    tracked = stream("tracker", "tool", 5.0)
    turns, shifts_mm = tracked.rotations.copy(), tracked.translations_mm.copy()
    turns[list(lost)], shifts_mm[list(lost)] = np.eye(3), 0.0
    path = write(tmp_path / "a.igs.mha", replace(tracked, rotations=turns, translations_mm=shifts_mm))
    folder = tmp_path / "poses"
    folder.mkdir()
    for n, (turn, shift_mm) in enumerate(zip(turns, shifts_mm, strict=True)):
        matrix = np.vstack([np.column_stack([turn, shift_mm]), [0, 0, 0, 1]])
        np.savetxt(folder / f"{n}.txt", matrix)
    for valid in (read_sequence(path).poses["tracker_from_tool"].valid, recorded_poses(folder).valid):
        assert np.flatnonzero(~valid).tolist() == list(lost)
    assert f"exactly the identity in {len(lost)} of 4 frames" in caplog.text
    assert f"{len(lost)} of 4 poses were lost" in caplog.text


def test_a_reference_that_is_always_the_identity_is_the_tracker(tmp_path: Path) -> None:
    tracked = stream("tracker", "reference", 5.0)
    still = np.tile(np.eye(3), (4, 1, 1))
    path = write(tmp_path / "a.igs.mha", replace(tracked, rotations=still, translations_mm=np.zeros((4, 3))))
    assert read_sequence(path).poses["tracker_from_reference"].valid.all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no rows of numbers"),
        ("1 2 3\n", "has 3 columns"),
        ("1 2 3 0 0 0 9\n", "quaternion of row 1 has length 9"),
        ("1 2 3 0 0 0 one\n", "line 1: '1 2 3 0 0 0 one'; needed poses"),
        ("1 2 3 0 0 0 1\n1 2\n", "line 2: 2 cells, but 7 in the first row"),
        ("inf 2 3 0 0 0 1\n", "line 1: a number is beyond"),
        ("date = 3\n1 2 3 0 0 0 1\n", "'date = 3' is not a number"),
        ("1,5 2,5 3,5 0,0 0,0 0,0 1,0\n", "may have decimal commas"),
        ("t,x,y,z,qx,qy,qz,qw\nnan,1,2,3,0,0,0,1\n", "a time that is not finite"),
        ("x,y,z,qx,qy,qz\n1,2,3,0,0,0\n", "once \\(not qw\\)"),
        ("x [in],y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n", "column 1 is in 'in'; needed mm, cm, m"),
        ("".join(f"0.{i} 0.2 1.1 0 0 0 1\n" for i in range(10, 30)), "are in m, not mm"),
        ("".join(f"{i}e4 2 3 0 0 0 1\n" for i in range(1, 5)), "no tracker measures beyond"),
    ],
)
def test_bad_tables(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(UnreadableFileError, match=message):
        read_poses(tmp_path / "a.txt")


def test_absent_and_empty(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="does not exist; needed tool poses"):
        read_poses(tmp_path / "none.txt")
    with pytest.raises(UnreadableFileError, match="is empty"):
        read_poses(tmp_path)


def test_written_poses_read_back(tmp_path: Path) -> None:
    one = stream("tracker", "tool", 0.1 + 0.2)
    write_poses(one, tmp_path / "a.igs.mha")
    back = read_poses(tmp_path / "a.igs.mha")
    np.testing.assert_array_equal(back.rotations, one.rotations)
    np.testing.assert_array_equal(back.translations_mm, one.translations_mm)


ROW = "{t},1,2,90{i},0,0,0.6,0.8"
NAMES = "t,x,y,z,qx,qy,qz,qw"


def table(path: Path, header: str, rows: list[str]) -> Path:
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("name", "bad"), [("status", "MISSING"), ("valid", "0"), ("tracked", "false"), ("state", "Out of volume")]
)
def test_poses_that_a_column_marks_as_lost(tmp_path: Path, name: str, bad: str) -> None:
    good = "1" if bad == "0" else "OK"
    rows = [f"{ROW.format(t=i, i=i)},{bad if i == 2 else good}" for i in range(5)]
    poses = read_poses(table(tmp_path / "a.csv", f"{NAMES},{name}", rows))
    assert poses.valid.tolist() == [True, True, False, True, True]


@pytest.mark.parametrize("tools", [("probe", "ref"), ("0", "1")])
def test_poses_of_several_tools_in_one_table_are_refused(tmp_path: Path, tools: tuple[str, str]) -> None:
    rows = [f"{ROW.format(t=i, i=i)},{tools[i % 2]}" for i in range(6)]
    with pytest.raises(UnreadableFileError, match=r"poses of several tools \(column 'tool'"):
        read_poses(table(tmp_path / "a.csv", f"{NAMES},tool", rows))


@pytest.mark.parametrize(
    ("name", "times", "first_s"),
    [
        ("t_ns", ["1700000000050000000", "1700000000100000000"], 1700000000.05),
        ("time", ["23:59:59.95", "00:00:00.00"], 86399.95),
    ],
)
def test_times_of_poses_in_ns_and_of_day(tmp_path: Path, name: str, times: list[str], first_s: float) -> None:
    rows = [ROW.format(t=t, i=i) for i, t in enumerate(times)]
    poses = read_poses(table(tmp_path / "a.csv", NAMES.replace("t", name, 1), rows))
    np.testing.assert_allclose(poses.t_s - first_s, [0.0, 0.05], atol=1e-6)


def test_a_pose_that_ndi_could_not_measure_is_lost(tmp_path: Path) -> None:
    rows = [ROW.format(t=0, i=0), "1" + ",-3.697314E+28" * 7, ROW.format(t=2, i=2)]
    header = NAMES.replace("qx,qy,qz,qw", "q1,q2,q3,q0")
    assert read_poses(table(tmp_path / "a.csv", header, rows)).valid.tolist() == [True, False, True]
