"""Tracked sequences: real PLUS recordings, round trips, other readers, and every way a file can be bad."""

import gzip
import logging
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvf_ig.core import InvalidInputError, OutputError, PoseStream, TrackedSequence, UnreadableFileError
from dvf_ig.io import read_sequence, write_poses, write_sequence

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
    expected = SimpleITK.GetArrayViewFromImage(SimpleITK.ReadImage(str(path)))
    np.testing.assert_array_equal(sequence.images, expected)


def test_real_pose_digits(data_dir: Path) -> None:
    sequence = read_sequence(data_dir / REAL[0][0])
    probe = sequence.poses["tracker_from_probe"]
    assert probe.translations_mm[0].tolist() == [284.342, -37.5047, -13.1385]
    assert probe.rotations[0, 0].tolist() == [0.214041, -0.922145, 0.322235]
    assert sequence.t_s[:2].tolist() == [2572.905343, 2572.983529]


def test_rf_data_are_refused(data_dir: Path) -> None:
    with pytest.raises(UnreadableFileError, match="MET_SHORT.*scan-convert"):
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
    orientation = draw(st.sampled_from(["MF", "MFA", "UN"]))
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


def metafile(frames: str, *, size: str = "0 0 2", kind: str = "MET_UCHAR", extra: str = "") -> str:
    return (
        f"ObjectType = Image\nNDims = 3\nBinaryData = True\nCompressedData = False\nDimSize = {size}\n"
        f"ElementType = {kind}\n{extra}{frames}ElementDataFile = LOCAL\n"
    )


MATRIX = "1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1"


def test_neither_status_nor_time(tmp_path: Path) -> None:
    frames = "".join(f"Seq_Frame000{i}_ToolToTrackerTransform = {MATRIX}\n" for i in range(2))
    path = tmp_path / "a.igs.mha"
    path.write_text(metafile(frames))
    sequence = read_sequence(path)
    assert not sequence.has_timestamps
    assert sequence.t_s.tolist() == [0, 1]
    assert sequence.poses["tracker_from_tool"].valid.all()
    assert sequence.orientation == "XX"


def test_invalid_samples_are_not_looked_at(tmp_path: Path) -> None:
    frames = (
        f"Seq_Frame0000_ToolToTrackerTransform = {MATRIX}\n"
        "Seq_Frame0001_ToolToTrackerTransform = out of view\n"
        "Seq_Frame0001_ToolToTrackerTransformStatus = OUT_OF_VIEW\n"
        "Seq_Frame0002_ToolToTrackerTransform = 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n"
        "Seq_Frame0002_ToolToTrackerTransformStatus = MISSING\n"
    )
    path = tmp_path / "a.igs.mha"
    path.write_text(metafile(frames, size="0 0 4"))
    assert read_sequence(path).poses["tracker_from_tool"].valid.tolist() == [True, False, False, False]


def test_image_maps_are_not_poses(tmp_path: Path) -> None:
    scaled = "0.1 0 0 5 0 0.1 0 6 0 0 0.1 7 0 0 0 1"
    frames = "".join(
        f"Seq_Frame000{i}_{name} = {scaled if 'Image' in name else MATRIX}\n"
        for i in range(2)
        for name in ("ImageToProbeTransform", "ProbeToTrackerTransform")
    )
    path = tmp_path / "a.igs.mha"
    path.write_text(metafile(frames))
    assert list(read_sequence(path).poses) == ["tracker_from_probe"]


def test_repeated_and_reordered_time_stamps(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    lines = []
    for i, t in enumerate([1.0, 2.0, 2.0, 1.5, 3.0]):
        matrix = f"1 0 0 {i} 0 1 0 0 0 0 1 0 0 0 0 1"
        lines += [f"Seq_Frame000{i}_ToolToTrackerTransform = {matrix}", f"Seq_Frame000{i}_Timestamp = {t}"]
    header = metafile("\n".join(lines) + "\n", size="1 1 5")
    path = tmp_path / "a.igs.mha"
    path.write_bytes(header.encode() + bytes([10, 11, 12, 13, 14]))
    with caplog.at_level(logging.WARNING, "dvf_ig.io"):
        sequence = read_sequence(path)
    assert sequence.t_s.tolist() == [1.0, 1.5, 2.0, 3.0]
    assert sequence.images is not None
    assert sequence.images.ravel().tolist() == [10, 13, 11, 14]
    assert sequence.poses["tracker_from_tool"].translations_mm[:, 0].tolist() == [0, 3, 1, 4]
    assert "dropped 1 of 5 frames" in caplog.text


def test_frozen_poses_are_kept(tmp_path: Path) -> None:
    frames = "".join(f"Seq_Frame000{i}_ToolToTrackerTransform = {MATRIX}\n" for i in range(9))
    path = tmp_path / "a.igs.mha"
    path.write_text(metafile(frames, size="0 0 9"))
    stream = read_sequence(path).poses["tracker_from_tool"]
    assert len(stream) == 9
    assert stream.valid.all()


def test_separate_pixel_file(tmp_path: Path) -> None:
    header = metafile("", size="2 3 2").replace("LOCAL", "pixels.raw")
    (tmp_path / "a.igs.mhd").write_text(header)
    with pytest.raises(UnreadableFileError, match=r"pixels\.raw does not exist"):
        read_sequence(tmp_path / "a.igs.mhd")
    (tmp_path / "pixels.raw").write_bytes(bytes(range(12)))
    images = read_sequence(tmp_path / "a.igs.mhd").images
    assert images is not None
    np.testing.assert_array_equal(images, np.arange(12).reshape(2, 3, 2))


@pytest.mark.parametrize("size", ["4 3", "4 3 1", "4 3 1 1"])
def test_a_single_frame_in_any_number_of_axes(tmp_path: Path, size: str) -> None:
    path = tmp_path / "a.igs.mha"
    path.write_bytes(metafile("", size=size).encode() + bytes(12))
    images = read_sequence(path).images
    assert images is not None
    assert images.shape == (1, 3, 4)


@pytest.mark.parametrize("encoding", ["raw", "gzip"])
def test_nrrd_sequence(tmp_path: Path, encoding: str) -> None:
    pixels = bytes(range(24))
    header = (
        "NRRD0005\n# a comment\ntype: unsigned char\ndimension: 3\nsizes: 4 3 2\n"
        f"kinds: domain domain list\nencoding: {encoding}\nendian: little\n"
        "ultrasound image orientation:=MF\n"
        f"Seq_Frame0000_ProbeToTrackerTransform:={MATRIX}\nSeq_Frame0000_ProbeToTrackerTransformStatus:=OK\n"
        "Seq_Frame0000_Timestamp:=4.5\nSeq_Frame0000_Status:=OK\n"
        f"Seq_Frame0001_ProbeToTrackerTransform:={MATRIX}\n"
        "Seq_Frame0001_ProbeToTrackerTransformStatus:=INVALID\n"
        "Seq_Frame0001_Timestamp:=4.75\nSeq_Frame0001_Status:=INVALID\n\n"
    )
    path = tmp_path / "a.igs.nrrd"
    path.write_bytes(header.encode() + (gzip.compress(pixels) if encoding == "gzip" else pixels))
    sequence = read_sequence(path)
    assert sequence.images is not None
    np.testing.assert_array_equal(sequence.images, np.arange(24).reshape(2, 3, 4))
    assert sequence.image_valid.tolist() == [True, False]
    assert sequence.poses["tracker_from_probe"].valid.tolist() == [True, False]
    assert sequence.t_s.tolist() == [4.5, 4.75]
    assert sequence.orientation == "MF"


@pytest.mark.parametrize("keep", [0.999, 0.9, 0.5])
def test_truncated_compressed_file(tmp_path: Path, keep: float) -> None:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (5, 32, 32)).astype(np.uint8)
    write_sequence(TrackedSequence(np.arange(5.0), images, np.ones(5, bool), {}), tmp_path / "a.igs.mha")
    data = (tmp_path / "a.igs.mha").read_bytes()
    (tmp_path / "a.igs.mha").write_bytes(data[: int(keep * len(data))])
    with pytest.raises(UnreadableFileError, match=r"truncated: its images have \d+ bytes, .* needs 5120"):
        read_sequence(tmp_path / "a.igs.mha")


def test_damaged_compressed_data(tmp_path: Path) -> None:
    write_sequence(known_shift(), tmp_path / "a.igs.mha")
    data = bytearray((tmp_path / "a.igs.mha").read_bytes())
    data[-8:-4] = b"\xff\xff\xff\xff"
    (tmp_path / "a.igs.mha").write_bytes(data)
    with pytest.raises(UnreadableFileError, match="damaged|truncated"):
        read_sequence(tmp_path / "a.igs.mha")


FRAME0 = f"Seq_Frame0000_ToolToTrackerTransform = {MATRIX}\n"
BAD = [
    ("", "no ElementDataFile"),
    ("just some notes\n", "no ElementDataFile"),
    ("ObjectType = Image\nrubbish\nElementDataFile = LOCAL\n", "'rubbish' is not 'name = value'"),
    ("ObjectType = Image\nElementDataFile = LOCAL\n", "DimSize is 'absent'"),
    (metafile("", size="a b c"), "whole numbers"),
    (metafile("", size="4 3 0"), "no frames"),
    (metafile("", size="4 3 2 7"), "4 axes"),
    (metafile("", size="4 3 2"), "truncated: its images have 0 bytes, its header needs 24"),
    (metafile("", size="4 3 2", extra="ElementNumberOfChannels = 3\n"), "3 channel"),
    (metafile("", size="4 3 2", extra="Kinds = list domain domain\n"), "axes are list domain domain"),
    (metafile(FRAME0 + "Seq_Frame0000_Timestamp = 1\n"), "1 of 2 frames have no Timestamp"),
    (
        metafile("Seq_Frame0000_Timestamp = 1\nSeq_Frame0001_Timestamp = nan\n"),
        "Timestamp of frame 1 is not finite",
    ),
    (metafile("Seq_Frame0000_Timestamp = soon\nSeq_Frame0001_Timestamp = 2\n"), "not a number"),
    (metafile("Seq_Frame0000_ToolToTrackerTransform = 1 2 3\n"), "frame 0 is '1 2 3'; needed 16 numbers"),
    (metafile(FRAME0.replace("0000", "0007")), "a field of frame 7"),
    (metafile(FRAME0.replace(" 0 0 0 1\n", " 0 0 0 2\n")), "last row"),
    (metafile(FRAME0.replace("= 1 0", "= 2 0")), "not a rotation"),
    (metafile(FRAME0.replace("= 1 0", "= nan 0")), "non-finite poses whose status is OK"),
    ("NRRD0005\ntype: uchar\nsizes: 4 3 2\nencoding: bzip2\n\n", "encoding 'bzip2'"),
    ("NRRD0005\ntype: float\nsizes: 4 3 2\nencoding: raw\n\n", "pixels are float"),
]


@pytest.mark.parametrize(("text", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.igs.mha"
    path.write_text(text)
    with pytest.raises(UnreadableFileError, match=message) as caught:
        read_sequence(path)
    assert "bad.igs.mha" in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(max_examples=60)
@given(data=st.binary(max_size=300))
def test_garbage_never_escapes_as_another_error(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.mktemp("case") / "a.igs.mha"
    for start in (b"", b"NRRD0005\n", b"NDims = 3\nDimSize = 1 1 1\nElementDataFile = LOCAL\n"):
        path.write_bytes(start + data)
        try:
            read_sequence(path)
        except UnreadableFileError:
            pass


def test_absent_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_sequence(tmp_path / "none.igs.mha")
    with pytest.raises(UnreadableFileError, match="cannot read"):
        read_sequence(tmp_path)


def test_names_that_plus_cannot_spell(tmp_path: Path) -> None:
    times = np.arange(2.0)
    eye = np.tile(np.eye(3), (2, 1, 1))
    stream = PoseStream("tracker", "tool_2", times, eye, np.zeros((2, 3)), np.ones(2, bool))
    with pytest.raises(InvalidInputError, match="tool_2"):
        write_poses(stream, tmp_path / "a.igs.mha")
    assert list(tmp_path.iterdir()) == []


def test_unwritable_target(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist; make it first"):
        write_sequence(known_shift(), tmp_path / "nowhere" / "a.igs.mha")
    (tmp_path / "a.igs.mha").mkdir()
    with pytest.raises(OutputError, match="is a folder"):
        write_sequence(known_shift(), tmp_path / "a.igs.mha")
