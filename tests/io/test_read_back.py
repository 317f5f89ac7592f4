"""Pose, landmarks and poses over time read back without our readers: each at its known place to 1e-6 mm.

What 3D Slicer does is written out here, by its sources: images and ITK transforms are LPS in files and RAS in
the scene; an ITK transform becomes the inverse of *transform to parent*; the matrices of a PLUS or transform
sequence are *transform to parent* as they stand.
"""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import SimpleITK

from dvf_ig.core import InvalidInputError, Landmarks, OutputError, Points, Rigid
from dvf_ig.io import (
    read_landmarks,
    read_sequence,
    write_landmarks,
    write_pose_sequence,
    write_registration,
    write_transforms,
)
from dvf_ig.io.provenance import recorded_inputs

MR_FROM_TRACKER = Rigid.from_rotation_vector([0.4, -0.9, 0.3], [12.5, -40.25, 310.75], "mr", "tracker")
TRACKER_MM = np.array([[10.0, 20.0, 30.0], [-55.5, 4.25, -120.0], [0.0, 0.0, 0.0]])
MR_MM = TRACKER_MM @ MR_FROM_TRACKER.rotation.T + MR_FROM_TRACKER.translation_mm
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


def moved(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def itk_matrix(path: Path) -> np.ndarray:
    """The matrix of a transform file, as SimpleITK applies it."""
    transform = SimpleITK.ReadTransform(str(path))
    matrix = np.eye(4)
    matrix[:3, 3] = transform.TransformPoint((0.0, 0.0, 0.0))
    for axis in range(3):
        matrix[:3, axis] = np.array(transform.TransformPoint(np.eye(3)[axis].tolist())) - matrix[:3, 3]
    return matrix


def to_parent(path: Path) -> np.ndarray:
    """What 3D Slicer makes of an ITK transform file."""
    return np.linalg.inv(FLIP @ itk_matrix(path) @ FLIP)


def sequence_matrices(path: Path) -> tuple[list[float], list[np.ndarray], str]:
    """Times and matrices as vtkMRMLLinearTransformSequenceStorageNode reads them, and the header."""
    text = path.read_bytes().decode().split("ElementDataFile")[0]
    fields = dict(line.split(" = ", 1) for line in text.splitlines())
    assert all(len(line) < 1000 for line in text.splitlines())
    frames = sorted(name for name in fields if re.fullmatch(r"Seq_Frame\d+_TrackerToRasTransform", name))
    times = [float(fields[name.replace("TrackerToRasTransform", "Timestamp")]) for name in frames]
    return times, [np.array(fields[n].split(), dtype=float).reshape(4, 4) for n in frames], text


@pytest.mark.parametrize("ending", [".tfm", ".h5"])
def test_a_pose_moves_points_to_their_places(tmp_path: Path, ending: str) -> None:
    write_transforms(MR_FROM_TRACKER, tmp_path / "pose.tfm")
    transform = SimpleITK.ReadTransform(str((tmp_path / "pose.tfm").with_suffix(ending)))
    found = [transform.TransformPoint(point) for point in TRACKER_MM.tolist()]
    np.testing.assert_allclose(found, MR_MM, atol=1e-6)


@pytest.mark.parametrize("ending", [".tfm", ".h5"])
def test_the_mr_is_resampled_to_its_place_in_the_tracker(tmp_path: Path, ending: str) -> None:
    """Linear interpolation of a ramp is exact: each resampled voxel names the place that it came from."""
    write_transforms(MR_FROM_TRACKER, tmp_path / "pose.tfm")
    transform = SimpleITK.ReadTransform(str((tmp_path / "pose.tfm").with_suffix(ending)))
    tracker = SimpleITK.Image((5, 6, 7), SimpleITK.sitkFloat64)
    tracker.SetOrigin((8.0, 18.0, 28.0))
    centre = MR_MM[0]
    for axis in range(3):
        mr = SimpleITK.PhysicalPointSource(
            SimpleITK.sitkVectorFloat64, (60, 60, 60), (centre - 30.0).tolist(), (1.0, 1.0, 1.0)
        )
        ramp = SimpleITK.VectorIndexSelectionCast(mr, axis)
        shown = SimpleITK.Resample(ramp, tracker, transform, SimpleITK.sitkLinear, -999.0)
        assert shown[2, 2, 2] == pytest.approx(centre[axis], abs=1e-6)  # the voxel at (10, 20, 30)


@pytest.mark.parametrize("ending", [".tfm", ".h5"])
def test_slicer_shows_the_mr_where_the_patient_is(tmp_path: Path, ending: str) -> None:
    """The guide: put the MR under the loaded transform as it is."""
    write_transforms(MR_FROM_TRACKER, tmp_path / "pose.tfm")
    shown_ras = moved(to_parent((tmp_path / "pose.tfm").with_suffix(ending)) @ FLIP, MR_MM)
    np.testing.assert_allclose(shown_ras, moved(FLIP, TRACKER_MM), atol=1e-6)


def test_slicer_shows_a_plus_sequence_on_the_mr_by_the_transform_sequence(tmp_path: Path) -> None:
    """A point that PLUS's matrices put at p_tracker, under a frame of the sequence, is shown on the MR."""
    later = Rigid.from_rotation_vector([0.1, 0.2, 0.3], [1, 2, 3], "mr", "tracker")
    write_pose_sequence([(1.5, MR_FROM_TRACKER), (2.25, later)], tmp_path / "poses.seq.mha")
    times, matrices, header = sequence_matrices(tmp_path / "poses.seq.mha")
    assert times == [1.5, 2.25]
    np.testing.assert_allclose(moved(matrices[0], TRACKER_MM), moved(FLIP, MR_MM), atol=1e-6)
    np.testing.assert_allclose(matrices[1], FLIP @ later.matrix, atol=1e-12)
    for matrix in matrices:  # a rotation of SimpleITK's own, which checks that it is one
        SimpleITK.VersorRigid3DTransform().SetMatrix(matrix[:3, :3].ravel().tolist())
    assert "TrackerToRas: p_ras = M p_tracker" in header
    assert "DimSize = 0 0 2" in header


def test_the_inverted_transform_file_does_not_fit_a_plus_sequence(tmp_path: Path) -> None:
    """Slicer counts the tracker's coordinates as LPS in the one and as RAS in the other."""
    write_transforms(MR_FROM_TRACKER, tmp_path / "pose.tfm")
    inverted = np.linalg.inv(to_parent(tmp_path / "pose.tfm"))
    assert np.linalg.norm(moved(inverted, TRACKER_MM) - moved(FLIP, MR_MM), axis=1)[:2].min() > 10.0
    turned = moved(inverted @ FLIP, TRACKER_MM)  # right for what was loaded as an image, LPS
    np.testing.assert_allclose(turned, moved(FLIP, MR_MM), atol=1e-6)


def test_plus_composes_tracker_to_ras_from_the_xml(tmp_path: Path) -> None:
    path = write_registration(MR_FROM_TRACKER, tmp_path / "mr_from_tracker.xml", error_mm=0.8)
    found = {
        (e.attrib["From"], e.attrib["To"]): np.array(e.attrib["Matrix"].split(), dtype=float).reshape(4, 4)
        for e in ElementTree.parse(path).getroot().iter("Transform")
    }
    assert list(found) == [("Tracker", "Mr"), ("Mr", "Ras")]
    np.testing.assert_allclose(moved(found["Tracker", "Mr"], TRACKER_MM), MR_MM, atol=1e-6)
    both = found["Mr", "Ras"] @ found["Tracker", "Mr"]
    np.testing.assert_allclose(moved(both, TRACKER_MM), MR_MM * (-1, -1, 1), atol=1e-6)
    path.write_text("<PlusConfiguration/>")
    with recorded_inputs(), pytest.raises(OutputError, match="a file of that name exists"):
        write_registration(MR_FROM_TRACKER, path)


def test_our_own_reader_takes_the_transform_sequence(tmp_path: Path) -> None:
    write_pose_sequence([(1.5, MR_FROM_TRACKER)], tmp_path / "p.seq.mha")
    back = read_sequence(tmp_path / "p.seq.mha").poses["ras_from_tracker"]
    np.testing.assert_allclose(back.translations_mm[0], MR_FROM_TRACKER.translation_mm * (-1, -1, 1))


def test_bad_transform_sequences(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"written as \.seq\.mha"):
        write_pose_sequence([(0.0, MR_FROM_TRACKER)], tmp_path / "p.mha")
    with pytest.raises(InvalidInputError, match="got 0"):
        write_pose_sequence([], tmp_path / "p.seq.mha")
    both = [(0.0, MR_FROM_TRACKER), (1.0, MR_FROM_TRACKER.inverse())]
    with pytest.raises(InvalidInputError, match="got 2"):
        write_pose_sequence(both, tmp_path / "p.seq.mha")


def test_landmarks_lie_at_their_places_through_the_transform(tmp_path: Path) -> None:
    """Markups of ours are parsed as JSON and moved by SimpleITK; a list of Slicer's, RAS, is read here."""
    names = ("apex", "mitral", "origin")
    write_landmarks(Landmarks(names, Points("tracker", TRACKER_MM)), tmp_path / "p.mrk.json")
    write_transforms(MR_FROM_TRACKER, tmp_path / "pose.tfm")
    transform = SimpleITK.ReadTransform(str(tmp_path / "pose.tfm"))
    (markup,) = json.loads((tmp_path / "p.mrk.json").read_text())["markups"]
    assert markup["coordinateSystem"] == "LPS"
    places = [transform.TransformPoint(point["position"]) for point in markup["controlPoints"]]
    np.testing.assert_allclose(places, MR_MM, atol=1e-6)
    rows = [
        f"{i},{x},{y},{z},0,0,0,1,1,1,0,{n},,"
        for i, (n, (x, y, z)) in enumerate(zip(names, TRACKER_MM * (-1, -1, 1), strict=True))
    ]
    (tmp_path / "p.fcsv").write_text("# CoordinateSystem = RAS\n" + "\n".join(rows) + "\n")
    listed = read_landmarks(tmp_path / "p.fcsv", "tracker")
    assert listed.names == names
    found = [transform.TransformPoint(point) for point in listed.points.xyz_mm.tolist()]
    np.testing.assert_allclose(found, MR_MM, atol=1e-6)
