"""Tracked sequences: real PLUS recordings, exact round trips, and other readers."""

import logging
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvf_ig.core import OutputError, PoseStream, TrackedSequence, UnreadableFileError
from dvf_ig.io import read_sequence, read_target_recording, write_poses, write_sequence

Same = Callable[..., None]

REAL = [
    ("plus-fcal20-nwire/fCal_Test_Calibration_3NWires_fCal2.0.igs.mha", 190, (616, 820), "MFA"),
    ("plus-temporal-watertank/WaterTankBottomTranslationTrackerBuffer.igs.mha", 5000, None, "MFA"),
    ("plus-temporal-watertank/WaterTankBottomTranslationTrackerBuffer-trimmed.igs.mha", 801, None, "XX"),
    ("plus-temporal-watertank/WaterTankBottomTranslationVideoBuffer.igs.mha", 201, (616, 820), "MFA"),
    ("plus-phantom-landmarks/EightLandmarkPointsTrackedForPhantomRegistration.igs.mha", 1000, None, "XX"),
    (
        "plus-nwire-segmentation/SegmentationTest_VLCUS_RandomStepperMotionData2.igs.mha",
        201,
        (480, 640),
        "MFA",
    ),
    ("plus-scanconv/BkCurvilinearScanConvertedData.igs.mha", 1, (400, 600), "MFA"),
    ("plus-scanconv/UltrasonixCurvilinearBrightnessData.igs.mha", 5, (96, 3640), "FM"),
]


@pytest.mark.parametrize(("name", "frames", "size", "orientation"), REAL, ids=lambda v: str(v)[-28:])
def test_real_plus_recordings(
    data_dir: Path, name: str, frames: int, size: tuple[int, int] | None, orientation: str
) -> None:
    sequence = read_sequence(data_dir / name)
    assert len(sequence) == frames
    assert (None if sequence.images is None else sequence.images.shape[1:]) == size
    assert sequence.orientation == orientation
    assert sequence.has_timestamps is ("segmentation" not in name)
    assert all(stream.valid.all() for stream in sequence.poses.values())


def test_real_pixels_agree_with_simpleitk(data_dir: Path) -> None:
    path = data_dir / REAL[0][0]
    sequence = read_sequence(path)
    assert sequence.images is not None
    expected = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path)))
    assert np.array_equal(sequence.images, expected)


def test_real_pose_digits(data_dir: Path) -> None:
    sequence = read_sequence(data_dir / REAL[0][0])
    probe = sequence.poses["tracker_from_probe"]
    assert probe.translations_mm[0].tolist() == [284.342, -37.5047, -13.1385]
    assert probe.rotations[0, 0].tolist() == [0.214041, -0.922145, 0.322235]
    assert sequence.t_s[:2].tolist() == [2572.905343, 2572.983529]


def test_rf_data_are_refused(data_dir: Path) -> None:
    with pytest.raises(UnreadableFileError, match=r"MET_SHORT.*scan-convert"):
        read_sequence(data_dir / "plus-scanconv/BkCurvilinearRfData.igs.mhd")


@st.composite
def sequences(draw: st.DrawFn) -> TrackedSequence:
    frames = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    times = np.cumsum(rng.uniform(1e-3, 0.3, frames)) + draw(st.floats(-1e6, 1e6))
    poses = {}
    for target, source in draw(st.sets(st.sampled_from([("tracker", "probe"), ("tracker", "stylus_tip")]))):
        valid = rng.random(frames) > 0.4
        rotations = Rotation.random(frames, rng=rng).as_matrix()
        rotations[~valid] = rng.choice([0.0, 1.5, np.nan])
        shift = rng.normal(size=(frames, 3)) * 10.0 ** rng.integers(-8, 4)
        poses[f"{target}_from_{source}"] = PoseStream(target, source, times, rotations, shift, valid)
    shape = (frames, draw(st.integers(1, 5)), draw(st.integers(1, 5)))
    images = rng.integers(0, 256, shape).astype(np.uint8) if draw(st.booleans()) else None
    timed = draw(st.booleans())
    if not timed:
        times = np.arange(frames, dtype=np.float64)
        poses = {
            n: PoseStream(p.target, p.source, times, p.rotations, p.translations_mm, p.valid)
            for n, p in poses.items()
        }
    orientation = draw(st.sampled_from(["MF", "MFA", "XX"]))
    return TrackedSequence(
        times, images, rng.random(frames) > 0.5, dict(sorted(poses.items())), timed, orientation
    )


@settings(max_examples=40)
@given(sequence=sequences(), compression=st.sampled_from([0, 1, 9]))
def test_round_trip_is_exact(
    tmp_path_factory: pytest.TempPathFactory, assert_same: Same, sequence: TrackedSequence, compression: int
) -> None:
    path = tmp_path_factory.mktemp("case") / "a.igs.mha"
    write_sequence(sequence, path, compression=compression)
    assert_same(read_sequence(path), sequence)


def known_shift() -> TrackedSequence:
    """Two frames, the second marked; the probe 7 mm along x in the first and 9 mm along y in the second."""
    images = np.zeros((2, 3, 4), np.uint8)
    images[1, 2, 3] = 201
    shift = np.array([[7.0, 0, 0], [0, 9.0, 0]])
    times = np.array([1.5, 1.75])
    stream = PoseStream(
        "tracker", "probe", times, np.tile(np.eye(3), (2, 1, 1)), shift, np.array([True, False])
    )
    return TrackedSequence(times, images, np.array([True, True]), {stream.name: stream})


def test_known_shift_read_by_simpleitk(tmp_path: Path) -> None:
    write_sequence(known_shift(), tmp_path / "a.igs.mha")
    image = SimpleITK.ReadImage(str(tmp_path / "a.igs.mha"))
    assert image.GetSize() == (4, 3, 2)
    assert image[3, 2, 1] == 201
    assert SimpleITK.GetArrayFromImage(image).sum() == 201
    text = image.GetMetaData("Seq_Frame0000_ProbeToTrackerTransform")
    assert np.array(text.split(), float).reshape(4, 4)[:3, 3].tolist() == [7, 0, 0]
    assert image.GetMetaData("Seq_Frame0001_ProbeToTrackerTransformStatus") == "INVALID"
    assert image.GetMetaData("Seq_Frame0001_Timestamp") == "1.75"
    assert image.GetMetaData("UltrasoundImageOrientation") == "MFA"


def test_header_is_what_plus_expects(tmp_path: Path) -> None:
    write_sequence(known_shift(), tmp_path / "a.igs.mha")
    data = (tmp_path / "a.igs.mha").read_bytes()
    head, payload = data.split(b"ElementDataFile = LOCAL\n")
    fields = dict(line.split(" = ", 1) for line in head.decode().splitlines())
    assert fields["NDims"] == "3"
    assert fields["DimSize"] == "4 3 2"
    assert fields["Kinds"] == "domain domain list"
    assert fields["ElementType"] == "MET_UCHAR"
    assert fields["CompressedData"] == "True"
    assert int(fields["CompressedDataSize"]) == len(payload)
    assert len(zlib.decompress(payload)) == 24
    assert fields["Seq_Frame0000_ImageStatus"] == "OK"


def test_pose_only_header(tmp_path: Path) -> None:
    write_poses(known_shift().poses["tracker_from_probe"], tmp_path / "p.igs.mha")
    text = (tmp_path / "p.igs.mha").read_text()
    assert "DimSize = 0 0 2\n" in text
    assert "CompressedData = False\n" in text
    assert "Seq_Frame0000_ImageStatus = INVALID\n" in text
    assert text.endswith("ElementDataFile = LOCAL\n")


def test_other_endings_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"\.igs\.mha"):
        write_sequence(known_shift(), tmp_path / "a.nrrd")


@pytest.mark.parametrize(("stored", "flips"), [("UFA", (2,)), ("MN", (1,)), ("UND", (1, 2)), ("MFA", ())])
def test_images_are_turned_to_the_orientation_of_calibrations(
    tmp_path: Path, stored: str, flips: tuple[int, ...], caplog: pytest.LogCaptureFixture
) -> None:
    """One recording, its pixels stored in four ways; a table of points counts them as they are stored."""
    whole = known_shift()
    assert whole.images is not None
    path, table = tmp_path / "a.igs.mha", tmp_path / "points.csv"
    write_sequence(replace(whole, images=np.flip(whole.images, flips).copy(), orientation=stored), path)
    row, column = np.argwhere(np.flip(whole.images, flips)[1] == 201)[0]
    table.write_text(f"frame,column1_px,row1_px\n1,{column},{row}\n")
    with caplog.at_level(logging.WARNING, "dvf_ig.io"):
        back = read_sequence(path)
    np.testing.assert_array_equal(back.images, whole.images)
    assert (back.orientation[:2], back.turned_from) == ("MF", stored if flips else None)
    assert ("were turned to MF" in caplog.text) == bool(flips)
    _, points_px = read_target_recording(path, table)
    assert points_px[1, 0].tolist() == [3, 2]


def test_lines_of_the_transducer_and_volumes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.igs.mha"
    write_sequence(replace(known_shift(), orientation="FM"), path)
    assert read_sequence(path).orientation == "FM"
    assert "not scan-converted" in caplog.text
    write_sequence(replace(known_shift(), orientation="AMF"), path)
    with pytest.raises(UnreadableFileError, match="UltrasoundImageOrientation is 'AMF'"):
        read_sequence(path)
