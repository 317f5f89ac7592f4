"""Sequence files as others write them: dialects that must be read, damage that must be named."""

import contextlib
import gzip
import logging
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError, OutputError, PoseStream, TrackedSequence, UnreadableFileError
from dvf_ig.io import read_sequence, write_poses, write_sequence
from dvf_ig.io.plus.sequence_read import read_indexed_sequence


def two_frames() -> TrackedSequence:
    """Two frames of 3 × 4 pixels."""
    return TrackedSequence(np.array([1.5, 1.75]), np.zeros((2, 3, 4), np.uint8), np.ones(2, bool), {})


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


def stamped(path: Path, stamps: list[float]) -> Path:
    """Frames in this order; the tool of frame i is i mm along x, its one pixel 10 + i."""
    lines = []
    for i, t in enumerate(stamps):
        matrix = f"1 0 0 {i} 0 1 0 0 0 0 1 0 0 0 0 1"
        lines += [f"Seq_Frame000{i}_ToolToTrackerTransform = {matrix}", f"Seq_Frame000{i}_Timestamp = {t}"]
    header = metafile("\n".join(lines) + "\n", size=f"1 1 {len(stamps)}")
    path.write_bytes(header.encode() + bytes(range(10, 10 + len(stamps))))
    return path


def test_repeated_and_reordered_time_stamps(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = stamped(tmp_path / "a.igs.mha", [1.0, 1.1, 1.1, 1.05, 1.2])
    with caplog.at_level(logging.WARNING, "dvf_ig.io"):
        sequence = read_sequence(path)
    assert sequence.t_s.tolist() == [1.0, 1.05, 1.1, 1.2]
    assert sequence.images is not None
    assert sequence.images.ravel().tolist() == [10, 13, 11, 14]
    assert sequence.poses["tracker_from_tool"].translations_mm[:, 0].tolist() == [0, 3, 1, 4]
    assert "dropped 1 of 5 frames" in caplog.text
    assert "jumps back" not in caplog.text


def test_frames_without_fields_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Frame 2 of five has no field at all, as in a recording whose first frames PLUS dropped."""
    path = stamped(tmp_path / "a.igs.mha", [1.0, 1.1, 1.2, 1.3, 1.4])
    path.write_bytes(re.sub(rb"Seq_Frame0002_.*\n", b"", path.read_bytes()))
    with caplog.at_level(logging.WARNING, "dvf_ig.io"):
        sequence, indices, frames = read_indexed_sequence(path)
    assert (indices.tolist(), frames) == ([0, 1, 3, 4], 5)
    assert sequence.images is not None
    assert sequence.images.ravel().tolist() == [10, 11, 13, 14]
    assert sequence.poses["tracker_from_tool"].translations_mm[:, 0].tolist() == [0, 1, 3, 4]
    assert "1 of 5 frames have no Timestamp and are left out: frame 2" in caplog.text


def test_stamps_in_ms_are_noted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_sequence(stamped(tmp_path / "a.igs.mha", [0.0, 50.0, 100.0]))
    assert "one sample in 50 s" in caplog.text
    assert "are in ms (then 20 a second)" in caplog.text


def test_recorded_image_maps_are_kept_or_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    fixed = "".join(f"Seq_Frame000{i}_ImageToProbeTransform = {MATRIX}\n" for i in range(2))
    moving = f"Seq_Frame0000_ImageToTrackerTransform = {MATRIX}\n" + (
        f"Seq_Frame0001_ImageToTrackerTransform = 2{MATRIX[1:]}\n"
    )
    path = tmp_path / "a.igs.mha"
    path.write_text(metafile(fixed + moving))
    assert list(read_sequence(path).image_maps) == ["probe_from_image"]
    assert "ImageToTrackerTransform is not one fixed map of the image and is left out" in caplog.text


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


def test_a_frame_without_the_status_that_others_state_is_lost(tmp_path: Path) -> None:
    lines = "".join(f"Seq_Frame000{k}_ToolToTrackerTransform = {MATRIX}\n" for k in range(2))
    lines += "".join(f"Seq_Frame000{k}_Timestamp = {k}\n" for k in range(2))
    (tmp_path / "a.mha").write_text(metafile(lines))
    assert read_sequence(tmp_path / "a.mha").poses["tracker_from_tool"].valid.tolist() == [True, True]
    (tmp_path / "a.mha").write_text(metafile(lines + "Seq_Frame0001_ToolToTrackerTransformStatus = OK\n"))
    assert read_sequence(tmp_path / "a.mha").poses["tracker_from_tool"].valid.tolist() == [False, True]


@pytest.mark.parametrize("keep", [0.999, 0.9, 0.5])
def test_truncated_compressed_file(tmp_path: Path, keep: float) -> None:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (5, 32, 32)).astype(np.uint8)
    write_sequence(TrackedSequence(np.arange(5.0), images, np.ones(5, bool), {}), tmp_path / "a.igs.mha")
    data = (tmp_path / "a.igs.mha").read_bytes()
    (tmp_path / "a.igs.mha").write_bytes(data[: int(keep * len(data))])
    with pytest.raises(UnreadableFileError, match=r"truncated: its (compressed )?image data"):
        read_sequence(tmp_path / "a.igs.mha")


def test_damaged_compressed_data(tmp_path: Path) -> None:
    write_sequence(two_frames(), tmp_path / "a.igs.mha")
    data = bytearray((tmp_path / "a.igs.mha").read_bytes())
    data[-8:-4] = b"\xff\xff\xff\xff"
    (tmp_path / "a.igs.mha").write_bytes(data)
    with pytest.raises(UnreadableFileError, match=r"damaged|truncated"):
        read_sequence(tmp_path / "a.igs.mha")


FRAME0 = f"Seq_Frame0000_ToolToTrackerTransform = {MATRIX}\n"
BAD = [
    ("", "no ElementDataFile"),
    ("just some notes\n", "no ElementDataFile"),
    ("ObjectType = Image\nrubbish\nElementDataFile = LOCAL\n", "'rubbish' is not 'name = value'"),
    ("ObjectType = Image\nElementDataFile = LOCAL\n", "DimSize is 'absent'"),
    (metafile("", size="a b c"), "whole numbers"),
    (metafile("", size="4 3 0"), "no frames"),
    (metafile("", size="0 0 99999999999"), "counts 99999999999 frames, the file has"),
    (metafile("", size="4 3 2 7"), "4 axes"),
    (metafile("", size="4 3 2"), "truncated: its image data have 0 bytes, its header needs 24"),
    (metafile("", size="4 3 2", extra="ElementNumberOfChannels = 3\n"), "3 channel"),
    (
        metafile("", size="4 3 2", extra="UltrasoundImageType = RF_REAL\n") + 24 * "x",
        "images are RF_REAL; needed BRIGHTNESS",
    ),
    (metafile("", size="4 3 2", extra="Kinds = list domain domain\n"), "axes are list domain domain"),
    (metafile(FRAME0 + "Seq_Frame0000_Timestamp = 1\n"), "1 of 2 frames have no Timestamp"),
    (
        metafile("Seq_Frame0000_Timestamp = 1\nSeq_Frame0001_Timestamp = nan\n"),
        "Timestamp of frame 1 is not finite",
    ),
    (metafile("Seq_Frame0000_Timestamp = soon\nSeq_Frame0001_Timestamp = 2\n"), "not a number"),
    (metafile("Seq_Frame0000_ToolToTrackerTransform = 1 2 3\n"), "frame 0 is '1 2 3'; needed 16 numbers"),
    (metafile(FRAME0.replace("0000", "0007")), "a field of frame 7"),
    (metafile("Seq_Frame0009_Timestamp = 1\n"), "a field of frame 9"),
    (
        metafile(FRAME0 + FRAME0.replace("= 1 0", "= 0 1")),
        "states Seq_Frame0000_ToolToTrackerTransform twice",
    ),
    (metafile("", extra="DimSize = 4 3 3\n"), "states DimSize twice, with different values"),
    (metafile("", size="1 1 2", extra="HeaderSize = 16\n") + "ab", "HeaderSize is '16'; needed 0"),
    (metafile("", size="1 1 2") + "abc", "longer than its header says"),
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
        with contextlib.suppress(UnreadableFileError):
            read_sequence(path)


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
        write_sequence(two_frames(), tmp_path / "nowhere" / "a.igs.mha")
    (tmp_path / "a.igs.mha").mkdir()
    with pytest.raises(OutputError, match="is a folder"):
        write_sequence(two_frames(), tmp_path / "a.igs.mha")


def test_what_a_header_states_for_all_frames(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A transform of the whole file, time stamps that only the unfiltered field has, a status of no name."""
    frames = "".join(
        f"Seq_Frame000{i}_ToolToTrackerTransform = {MATRIX}\nSeq_Frame000{i}_UnfilteredTimestamp = {i}.5\n"
        f"Seq_Frame000{i}_ToolToTrackerTransformStatus = {'OK' if i else '1'}\n"
        for i in range(2)
    )
    image = "0.1 0 0 5 0 0.1 0 6 0 0 0.1 7 0 0 0 1"
    path = tmp_path / "a.igs.mha"
    path.write_text(metafile(frames, extra=f"ImageToProbeTransform = {image}\n"))
    sequence = read_sequence(path)
    assert sequence.t_s.tolist() == [0.5, 1.5]
    assert sequence.image_maps["probe_from_image"][0].tolist() == [0.1, 0, 0, 5]
    assert sequence.poses["tracker_from_tool"].valid.tolist() == [False, True]
    assert "its UnfilteredTimestamp is used" in caplog.text
    assert "the status '1' of ToolToTrackerTransformStatus is not known" in caplog.text


def test_image_type_of_an_nrrd_sequence(tmp_path: Path) -> None:
    header = "NRRD0005\ntype: uchar\ndimension: 3\nsizes: 4 3 1\nkinds: domain domain list\nencoding: raw\n"
    path = tmp_path / "a.igs.nrrd"
    path.write_bytes(f"{header}ultrasound image type:=RF_REAL\n\n".encode() + bytes(12))
    with pytest.raises(UnreadableFileError, match="its images are RF_REAL"):
        read_sequence(path)
