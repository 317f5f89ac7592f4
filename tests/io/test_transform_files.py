"""Transforms as .tfm and .h5: points land where they must, images too, and nobody's file is replaced."""

import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation

from dvf_ig.core import OutputError, Rigid
from dvf_ig.io import read_transform, write_transform, write_transforms

TURN = Rotation.from_euler("z", 90, degrees=True).as_matrix()
MR_FROM_TRACKER = Rigid("mr", "tracker", TURN, np.array([10.0, 20.0, 30.0]))


def test_both_files_move_a_point_of_the_tracker_to_its_place_in_the_mr(tmp_path: Path) -> None:
    for path in write_transforms(MR_FROM_TRACKER, tmp_path / "mr_from_tracker.tfm", error_mm=0.7):
        transform = SimpleITK.ReadTransform(str(path))
        np.testing.assert_allclose(transform.TransformPoint((1.0, 0, 0)), (10, 21, 30), atol=1e-9)
        back = read_transform(path)
        assert back.name == "mr_from_tracker"
        np.testing.assert_allclose(back.matrix, MR_FROM_TRACKER.matrix, atol=1e-12)
    assert json.loads((tmp_path / "mr_from_tracker.json").read_text())["to"] == "mr"


@pytest.mark.parametrize("ending", [".tfm", ".h5"])
def test_the_mr_resampled_with_the_file_lies_where_the_patient_is(tmp_path: Path, ending: str) -> None:
    """A bright voxel at (10, 21, 30) of the MR must appear at (1, 0, 0) of the tracker."""
    write_transforms(MR_FROM_TRACKER, tmp_path / "t.tfm")
    mr = SimpleITK.Image((40, 40, 40), SimpleITK.sitkFloat32)
    mr[10, 21, 30] = 1.0
    tracker = SimpleITK.Image((9, 9, 9), SimpleITK.sitkFloat32)
    tracker.SetOrigin((-4.0, -4.0, -4.0))
    transform = SimpleITK.ReadTransform(str((tmp_path / "t.tfm").with_suffix(ending)))
    shown = SimpleITK.GetArrayFromImage(SimpleITK.Resample(mr, tracker, transform, SimpleITK.sitkLinear))
    assert np.argwhere(shown > 0.5).tolist() == [[4, 4, 5]]
    assert shown.max() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.usefixtures("in_a_command")
def test_a_users_own_files_beside_a_transform_are_kept(tmp_path: Path) -> None:
    own = tmp_path / "t.json"
    own.write_text('{"subject": 7}')
    with pytest.raises(OutputError, match=r"t\.json: a file of that name exists"):
        write_transforms(MR_FROM_TRACKER, tmp_path / "t.tfm")
    assert own.read_text() == '{"subject": 7}'
    assert not (tmp_path / "t.tfm").exists()
    own.write_text('{"kind": "tip", "written_by": "dvf_ig"}')
    with pytest.raises(OutputError, match="a file of that name exists"):
        write_transform(MR_FROM_TRACKER, tmp_path / "t.tfm")
    own.unlink()
    (tmp_path / "t.h5").write_bytes(b"the user's")
    with pytest.raises(OutputError, match=r"t\.h5: a file of that name exists"):
        write_transforms(MR_FROM_TRACKER, tmp_path / "t.tfm")
    assert (tmp_path / "t.h5").read_bytes() == b"the user's"
    (tmp_path / "t.h5").unlink()
    for _ in range(2):
        write_transforms(MR_FROM_TRACKER, tmp_path / "t.tfm")
