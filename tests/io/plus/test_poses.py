"""Pose streams from sequences, folders and tables."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import PoseStream, TrackedSequence, UnreadableFileError
from dvf_ig.io import read_poses, write_poses, write_sequence


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "rows of finite numbers"),
        ("1 2 3\n", "has 3 columns"),
        ("1 2 3 0 0 0 9\n", "quaternion of row 1 has length 9"),
        ("1 2 3 0 0 0 one\n", "not a table of numbers"),
        ("1 2 3 0 0 0 1\n1 2\n", "not a table of numbers|same length"),
        ("nan 2 3 0 0 0 1\n", "finite"),
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
