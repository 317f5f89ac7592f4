"""Headers that are damaged, hostile, or in other axes: refused in a sentence, or read where they lie."""

import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from dvf_ig.core import CycleTiming, UnreadableFileError
from dvf_ig.intake import describe
from dvf_ig.io import read_label_names, read_labels, read_volume, read_volume_series, write_timing
from dvf_ig.io.image.timing import read_timing
from dvf_ig.io.image.volume import image_dimension

VOXELS = bytes(range(24))
NRRD = {
    "type": "uint8",
    "dimension": "3",
    "space": "left-posterior-superior",
    "sizes": "2 3 4",
    "space directions": "(1,0,0) (0,2,0) (0,0,3)",
    "kinds": "domain domain domain",
    "encoding": "raw",
    "space origin": "(10,20,30)",
}
SFORM = (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)
NRRD_4D = NRRD | {
    "dimension": "4",
    "sizes": "2 3 4 2",
    "kinds": "domain domain domain list",
    "space directions": "(1,0,0) (0,2,0) (0,0,3) none",
}
META = {
    "NDims": "3",
    "TransformMatrix": "1 0 0 0 1 0 0 0 1",
    "Offset": "10 20 30",
    "ElementSpacing": "1 2 3",
    "DimSize": "2 3 4",
    "ElementType": "MET_UCHAR",
    "ElementDataFile": "LOCAL",
}


def nrrd(
    path: Path, changes: dict[str, str | None], voxels: bytes = VOXELS, base: dict[str, str] = NRRD
) -> Path:
    fields = {**base, **changes}
    text = "".join(f"{name}: {value}\n" for name, value in fields.items() if value is not None)
    path.write_bytes(f"NRRD0005\n{text}\n".encode() + voxels)
    return path


def meta(path: Path, changes: dict[str, str | None], voxels: bytes = VOXELS) -> Path:
    fields = {**META, **changes}
    fields["ElementDataFile"] = fields.pop("ElementDataFile")
    text = "".join(f"{name} = {value}\n" for name, value in fields.items() if value is not None)
    path.write_bytes(text.encode() + voxels)
    return path


def nifti(path: Path, at: int, form: str, *values: float) -> Path:
    """A NIfTI-1 file of 2 x 3 x 4 voxels of 1 mm with one field put in."""
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, 3, 2, 3, 4, 1, 1, 1, 1)
    struct.pack_into("<hh", header, 70, 2, 8)
    struct.pack_into("<9f", header, 76, 1, 1, 1, 1, 1, 1, 1, 1, 352)
    struct.pack_into("<2h6f", header, 252, 1, 0, 0, 0, 0, 0, 0, 0)
    header[344:348] = b"n+1\0"
    struct.pack_into(f"<{form}", header, at, *values)
    path.write_bytes(bytes(header) + VOXELS)
    return path


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"type": "x" * 2000}, "type is 'xxx"),
        ({"type": "block"}, "type is"),
        ({"sizes": "-1 3 4"}, "sizes is"),
        ({"sizes": "2 3 99999999999999999999"}, "sizes is"),
        ({"sizes": "2 3"}, "dimension is 3, sizes holds 2"),
        ({"dimension": "99"}, "dimension is"),
        ({"sizes": "65000 65000 65000"}, "at most"),
        ({"sizes": "65000 65000 65000", "encoding": "gzip"}, "truncated|at most"),
        ({"encoding": "gzip"}, "damaged"),
        ({"encoding": "ascii"}, "save it as raw or gzip"),
        ({"space units": '"m" "m" "m"'}, "'m'; needed mm"),
        (
            {"space": None, "space directions": None, "space origin": None, "units": '"m" "m" "m"'},
            "needed mm",
        ),
        ({"space": "scanner-xyz"}, "space is 'scanner-xyz'"),
        ({"space directions": "(nan,0,0) (0,2,0) (0,0,3)"}, "finite"),
        ({"space directions": "(0,0,0) (0,2,0) (0,0,3)"}, "no length"),
        ({"space directions": "(1,0,0) (0,2,0)"}, "space directions"),
        ({"space directions": "(1e300,0,0) (0,2,0) (0,0,3)"}, "finite numbers below"),
        ({"space origin": "(inf,0,0)"}, "finite"),
        ({"space origin": "(1e11,0,0)"}, "check the unit"),
        ({"kinds": "vector vector domain"}, "kinds"),
        ({"data file": "/etc/passwd"}, "its own folder"),
        ({"data file": "../a.raw"}, "its own folder"),
        ({"data file": "/dev/zero"}, "its own folder"),
        ({"data file": "%d.raw 0 999999999 1"}, "names 1000000000 files"),
        ({"data file": "%s%n.raw"}, "does not exist"),
        ({"spacings": "1 2 4"}, "states its axes twice .*'1 2 4'"),
        ({"spacings": "nan nan nan"}, None),
        ({"axis mins": "0 0 5"}, "states its axes twice"),
        ({"space": None, "space directions": None, "space origin": None}, "spacings is ''"),
        ({"space orign": "(1,2,3)"}, "a field 'space orign', which NRRD does not define"),
        ({"old min": "0"}, "values are quantised"),
        ({"sizes": "2 3 3"}, "longer than its header says"),
        ({"byte skip": "6", "sizes": "2 3 3"}, None),
        ({"space directions": "(0.001,0,0) (0,0.002,0) (0,0,0.003)"}, "which may be m or um"),
        ({"space directions": "(1000,0,0) (0,2000,0) (0,0,3000)"}, "which may be m or um"),
    ],
)
def test_nrrd_headers(tmp_path: Path, changes: dict[str, str | None], sentence: str | None) -> None:
    path = nrrd(tmp_path / "a.nrrd", changes)
    if sentence is None:
        assert read_volume(path).values[1, 2, -1] == VOXELS[-1]
        return
    with pytest.raises(UnreadableFileError, match=sentence) as caught:
        read_volume(path)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"NDims": "99"}, "NDims is '99'"),
        ({"NDims": "-1"}, "NDims is '-1'"),
        ({"NDims": "4"}, "NDims is 4, DimSize holds 3"),
        ({"DimSize": "0 3 4"}, "DimSize"),
        ({"DimSize": "2 3 5"}, "truncated"),
        ({"DimSize": "2 3 3"}, "longer than its header says"),
        ({"DimSize": "1024 1024 1024", "CompressedData": "True"}, "truncated"),
        ({"CompressedData": "True"}, "damaged"),
        (
            {"CompressedData": "True", "CompressedDataSize": "25"},
            "CompressedDataSize is 25, but 24 bytes follow",
        ),
        ({"CompresedData": "True"}, "field CompresedData is not known; write CompressedData"),
        ({"CompressedData": "perhaps"}, "CompressedData"),
        ({"Offset": "nan 0 0"}, "finite"),
        ({"Offset": "1e11 0 0"}, "check the unit"),
        ({"TransformMatrix": "1e300 0 0 0 1 0 0 0 1"}, "finite"),
        ({"ElementSpacing": "0 1 1"}, "sides of"),
        ({"ElementSpacing": "nan 1 1"}, "finite"),
        ({"DistanceUnits": "um"}, "needed mm"),
        ({"ElementNumberOfChannels": "3"}, r"3-D with 3 value\(s\)"),
        ({"ElementNumberOfChannels": "999999999"}, "ElementNumberOfChannels"),
        ({"ElementType": "MET_UCHAR_ARRAY"}, "ElementType"),
        ({"ElementDataFile": "/etc/passwd"}, "its own folder"),
        ({"ElementDataFile": "/dev/zero"}, "its own folder"),
        ({"ElementDataFile": "pipe"}, "is not a regular file"),
        ({"ElementDataFile": "link"}, "link to a file outside its folder"),
        ({"ElementDataFile": "%s%s%s%n.raw 1 4 1"}, "does not exist"),
        ({"ElementDataFile": "LIST"}, "names 0 files|does not exist|own folder"),
        ({"ElementDataFile": "a\0b"}, "own folder"),
        ({"BinaryData": "False"}, "binary"),
        ({"ObjectType": "Tube"}, "needed an Image"),
        (
            {"HeaderSize": "6", "DimSize": "2 3 3"},
            "HeaderSize is 6, which applies to raw voxels in a separate",
        ),
        ({"ElementSpacing": None}, "ElementSpacing is ''"),
        ({"ElementSize": "1 2 4"}, "ElementSpacing is '1 2 3', its ElementSize '1 2 4'"),
        ({"Position": "1 2 3"}, "occurs twice"),
        ({"ElementToIntensityFunctionSlope": "2"}, "is '2', which is not applied"),
        ({"CenterOfRotation": "0 0 5"}, "is '0 0 5', which is not applied"),
        (
            {"AnatomicalOrientation": "LPI"},
            "AnatomicalOrientation is 'LPI', but its TransformMatrix '1 0 0 0",
        ),
        ({"ElementSpacing": "0.001 0.002 0.003"}, "which may be m or um"),
        ({"Offset": "2e4 0 0"}, "check the unit"),
    ],
)
def test_metaimage_headers(tmp_path: Path, changes: dict[str, str | None], sentence: str) -> None:
    folder = tmp_path / "recording"
    folder.mkdir()
    os.mkfifo(folder / "pipe")
    (tmp_path / "outside").write_bytes(VOXELS)
    (folder / "link").symlink_to(tmp_path / "outside")
    path = meta(folder / "a.mha", changes)
    with pytest.raises(UnreadableFileError, match=sentence) as caught:
        read_volume(path)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    ("field", "sentence"),
    [
        ((80, "f", 0.0), "finite or not positive"),
        ((80, "f", -1.0), "finite or not positive"),
        ((80, "f", np.nan), "finite or not positive"),
        ((80, "f", np.inf), "finite or not positive"),
        ((76, "f", np.nan), "not finite"),
        ((80, "f", 1e30), "sides of"),
        ((268, "f", np.nan), "finite"),
        ((112, "f", np.inf), "finite"),
        ((123, "b", 1), "length is m"),
        ((123, "b", 5), "length is code 5"),
        ((108, "f", 352.5), "begin at byte 352.5"),
        ((252, "2h3f", 1, 0, 0.9, 0.9, 0.0), "quaternion of its qform has length 1.27"),
        ((40, "h", 99), "the sizes"),
        ((42, "h", -2), "the sizes"),
        ((42, "h", 32000), "truncated"),
        ((70, "h", 128), "data type"),
        ((72, "h", 7), "data type"),
        ((108, "f", -1), "begin at byte"),
        ((108, "f", np.nan), "begin at byte"),
        ((268, "f", 1e11), "check the unit"),
        ((344, "4s", b"ni1\0"), "not marked as NIfTI"),
        ((252, "2h", 0, 0), "qform_code and sform_code are 0"),
        ((46, "h", 3), "longer than its header says"),
        (
            (252, "2h6f12f", 1, 1, 0, 0, 0, 0, 0, 0, *SFORM[:11], 5),
            "up to 5.0 mm apart: .* at RAS 0 0 0 mm by",
        ),
        ((252, "2h6f12f", 1, 1, 0, 0, 1, 0, 0, 0, *SFORM), "two geometries"),
        (
            (252, "2h6f12f", 0, 1, 0, 0, 0, 0, 0, 0, 1.05, *SFORM[1:]),
            "sform has voxels of 1.05 1 1 mm, its pix",
        ),
        ((80, "3f", 0.001, 0.001, 0.001), "which may be m or um"),
    ],
)
def test_nifti_headers(tmp_path: Path, field: tuple[int, str, float], sentence: str) -> None:
    assert read_volume(nifti(tmp_path / "good.nii", 80, "f", 1.0)).values.shape == (2, 3, 4)
    with pytest.raises(UnreadableFileError, match=sentence):
        read_volume(nifti(tmp_path / "a.nii", *field))


def test_a_nifti_scale_that_is_not_set_changes_nothing(tmp_path: Path) -> None:
    """Headers that nibabel keeps in memory hold NaN."""
    values = read_volume(nifti(tmp_path / "a.nii", 112, "2f", np.nan, np.nan)).values
    np.testing.assert_array_equal(values, read_volume(nifti(tmp_path / "b.nii", 112, "2f", 1, 0)).values)


def test_a_nifti_pair_in_capitals(tmp_path: Path) -> None:
    data = nifti(tmp_path / "a.nii", 344, "4s", b"ni1\0").read_bytes()
    (tmp_path / "B.HDR").write_bytes(data[:108] + bytes(4) + data[112:352])
    (tmp_path / "B.IMG").write_bytes(VOXELS)
    for name in ("B.HDR", "B.IMG"):
        assert read_volume(tmp_path / name).values.shape == (2, 3, 4)


def test_a_unit_that_is_no_time_gives_no_times(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = nifti(tmp_path / "a.nii", 123, "b", 2 | 32)
    header = bytearray(path.read_bytes())
    struct.pack_into("<8h", header, 40, 4, 2, 3, 4, 10, 1, 1, 1)
    struct.pack_into("<f", header, 92, 0.08)
    path.write_bytes(header[:352] + 10 * VOXELS)
    assert read_volume_series(path).timing.timing_assumed
    assert "pixdim[4] is in 'Hz, ppm or rad', which is no unit of time" in caplog.text


@pytest.mark.parametrize("sizes", [(24,), (6, 4), (24, 1)])
def test_images_of_one_or_two_axes(tmp_path: Path, sizes: tuple[int, ...]) -> None:
    count = len(sizes)
    files = [nifti(tmp_path / "a.nii", 40, f"{count + 1}h", count, *sizes)]
    named = {"sizes": " ".join(map(str, sizes)), "dimension": str(count)}
    plain = {"space": None, "space directions": None, "space origin": None, "kinds": None}
    files.append(nrrd(tmp_path / "a.nrrd", named | plain))
    shape = {"NDims": str(count), "DimSize": named["sizes"], "Offset": "0 " * count}
    axes = {"TransformMatrix": " ".join(map(str, np.eye(count, dtype=int).ravel()))}
    files.append(meta(tmp_path / "a.mha", {**shape, **axes, "ElementSpacing": "1 " * count}))
    for path in files:
        for read in (read_labels, read_volume, read_volume_series, image_dimension, describe):
            with pytest.raises(UnreadableFileError, match=f"is {count}-D"):
                read(str(path))


@pytest.mark.parametrize("sizes", [(2, 3, 4, 1), (2, 3, 4, 1, 1), (2, 3, 4, 1, 1, 1, 1)])
def test_nifti_with_last_axes_of_one_voxel_is_3d(tmp_path: Path, sizes: tuple[int, ...]) -> None:
    path = nifti(tmp_path / "a.nii", 40, f"{len(sizes) + 1}h", len(sizes), *sizes)
    expected = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path))).T
    assert image_dimension(path) == 3
    np.testing.assert_array_equal(read_volume(path).values, expected.reshape(2, 3, 4))
    (labels,) = read_labels(path)
    np.testing.assert_array_equal(labels.values, expected.reshape(2, 3, 4))
    with pytest.raises(UnreadableFileError, match="is 3-D"):
        read_volume_series(path)


@pytest.mark.parametrize(
    ("space", "signs"),
    [
        ("left-posterior-superior-time", (1, 1, 1)),
        ("LPST", (1, 1, 1)),
        ("right-anterior-superior-time", (-1, -1, 1)),
        ("RAST", (-1, -1, 1)),
        ("LAST", (1, -1, 1)),
    ],
)
def test_space_and_time_in_other_axes(tmp_path: Path, space: str, signs: tuple[int, ...]) -> None:
    changes = {
        "space": space,
        "space directions": "(1,0,0,0) (0,2,0,0) (0,0,3,0) (0,0,0,40)",
        "space origin": "(10,20,30,0)",
    }
    path = nrrd(tmp_path / "a.nrrd", changes, VOXELS * 2, NRRD_4D)
    grid = read_volume_series(path).grid
    corners = [grid.to_mm(np.array(c, dtype=float)) for c in ((0, 0, 0), (1, 2, 3))]
    low, high = np.minimum(*corners), np.maximum(*corners)
    far = np.array([11.0, 24.0, 39.0]) * signs
    near = np.array([10.0, 20.0, 30.0]) * signs
    np.testing.assert_allclose(low, np.minimum(near, far))
    np.testing.assert_allclose(high, np.maximum(near, far))
    mixed = changes | {"space directions": "(1,0,0,1) (0,2,0,0) (0,0,3,0) (0,0,0,40)"}
    with pytest.raises(UnreadableFileError, match="mixed"):
        read_volume_series(nrrd(path, mixed, VOXELS * 2, NRRD_4D))


@pytest.mark.parametrize("kinds", ["domain domain domain list", "list domain domain domain"])
@pytest.mark.parametrize("space", ["left-posterior-superior", "right-anterior-superior"])
def test_a_list_of_values_a_voxel_is_a_series(tmp_path: Path, kinds: str, space: str) -> None:
    """As 3D Slicer writes sequences; held to SimpleITK, which reads the same file as vectors."""
    first = kinds.startswith("list")
    directions = "none (1,0,0) (0,2,0) (0,0,3)" if first else "(1,0,0) (0,2,0) (0,0,3) none"
    sizes = "2 2 3 4" if first else "2 3 4 2"
    changes = {"kinds": kinds, "space directions": directions, "sizes": sizes, "space": space}
    path = nrrd(tmp_path / "a.nrrd", changes, bytes(range(48)), NRRD_4D)
    assert image_dimension(path) == 4
    series, image = read_volume_series(path), SimpleITK.ReadImage(str(path))
    for index in np.ndindex(2, 3, 4):
        at = series.grid.to_index(np.array(image.TransformIndexToPhysicalPoint(index)))
        stored = [series.values[(phase, *np.rint(at).astype(int))] for phase in range(2)]
        assert tuple(stored) == image[index]


TIMED = NRRD_4D | {"sizes": "2 3 2 4"}
VALUES = "axis 3 index values:"
MULTI = "MultiVolume.FrameLabels:"


@pytest.mark.parametrize(
    ("stated", "order", "fractions", "rr_s"),
    [
        ({VALUES: "=0 200 600 400", "units": '"" "" "" "ms"'}, [0, 1, 3, 2], [0, 0.25, 0.5, 0.75], 0.8),
        ({VALUES: "=0.3 0.2 0.1 0.0"}, [3, 2, 1, 0], [0, 0.25, 0.5, 0.75], 0.4),
        ({VALUES: "=10 40 70 80", "labels": '"" "" "" "%R-R"'}, [0, 1, 2, 3], [0.1, 0.4, 0.7, 0.8], 1.0),
        ({VALUES: "=0 1 3 2", "labels": '"" "" "" "frame"'}, [0, 1, 3, 2], [0, 0.25, 0.5, 0.75], 1.0),
        (
            {MULTI: "=20,220,620,420", MULTI.replace("FrameLabels", "FrameIdentifyingDICOMTagUnits"): "=ms"},
            [0, 1, 3, 2],
            np.array([20, 220, 420, 620]) / 820,
            0.82,
        ),
        ({"spacings": "nan nan nan 0.2", "units": '"" "" "" "s"'}, [0, 1, 2, 3], [0, 0.25, 0.5, 0.75], 0.8),
    ],
)
def test_volumes_are_in_order_of_their_stated_times(
    tmp_path: Path, stated: dict[str, str], order: list[int], fractions: list[float], rr_s: float
) -> None:
    """3D Slicer's sequences and multi-volumes; dcm2niix issue 407."""
    voxels = np.repeat(np.arange(4, dtype=np.uint8), 12).tobytes()
    text = "".join(
        f"{name}: {value}\n" if name[-1] != ":" else f"{name}{value}\n" for name, value in stated.items()
    )
    path = nrrd(tmp_path / "a.nrrd", {"space origin": f"(0,0,0)\n{text.rstrip()}"}, voxels, TIMED)
    series = read_volume_series(path)
    assert series.values[:, 0, 0, 0].tolist() == order
    np.testing.assert_allclose(series.timing.fractions, fractions, atol=1e-9)
    assert series.timing.rr_s == pytest.approx(rr_s)
    assert series.timing.rr_assumed
    assert series.timing.timing_assumed == ("frame" in str(stated))
    (labels,) = read_labels(nrrd(tmp_path / "one.nrrd", {"sizes": "2 3 4 1"}, VOXELS, NRRD_4D))
    assert labels.grid.shape == (2, 3, 4)


@pytest.mark.parametrize(
    ("stated", "sentence"),
    [
        ({VALUES: "=0 200 200 400"}, "needed a time of its own for each"),
        ({VALUES: "=0 200 400"}, "needed 4 finite numbers"),
        ({VALUES: "=0 2 4 6", "units": '"" "" "" "s"'}, "a cycle of 8 s; a heart's has 0.2 to 3 s"),
        ({VALUES: "=0 40 80 100", "units": '"" "" "" "%"'}, "needed fractions of one RR interval"),
        ({VALUES: "=0 0.2 0.4 0.6", "units": '"" "" "" "%"'}, "spans 0.8 % of the RR interval"),
        ({VALUES: "=0 1 2 3", MULTI: "=0,100,300,200"}, "put its volumes in different orders"),
    ],
)
def test_times_of_no_cycle_are_refused(tmp_path: Path, stated: dict[str, str], sentence: str) -> None:
    text = "".join(
        f"{name}: {value}\n" if name[-1] != ":" else f"{name}{value}\n" for name, value in stated.items()
    )
    path = nrrd(tmp_path / "a.nrrd", {"space origin": f"(0,0,0)\n{text.rstrip()}"}, VOXELS * 2, TIMED)
    with pytest.raises(UnreadableFileError, match=sentence):
        read_volume_series(path)


def test_a_timing_file_that_contradicts_the_header_is_refused_unless_it_is_chosen(tmp_path: Path) -> None:
    path = nrrd(tmp_path / "a.nrrd", {"space origin": f"(0,0,0)\n{VALUES}=0 0.2 0.4 0.6"}, VOXELS * 2, TIMED)
    for fractions, rr_s, refused in (([0, 0.25, 0.5, 0.75], 0.82, False), ([0, 0.25, 0.5, 0.75], 1.2, True)):
        write_timing(CycleTiming(np.array(fractions), rr_s), tmp_path / "timing.json")
        if refused:
            with pytest.raises(
                UnreadableFileError, match=r"a cycle of 0\.8 s, timing\.json in its folder 1\.2 s"
            ):
                read_volume_series(path)
        else:
            assert read_volume_series(path).timing.rr_s == rr_s
        assert read_volume_series(path, tmp_path / "timing.json").timing.rr_s == rr_s


def test_a_timing_file_replaces_times_of_no_heart(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    changes = {"space origin": f"(0,0,0)\n{VALUES}=0 40 80 120", "units": '"" "" "" "s"'}
    path = nrrd(tmp_path / "a.nrrd", changes, VOXELS * 2, TIMED)
    with pytest.raises(UnreadableFileError, match="a cycle of 160 s"):
        read_volume_series(path)
    write_timing(CycleTiming(np.arange(4) / 4, 0.8), tmp_path / "timing.json")
    assert read_volume_series(path).timing.rr_s == 0.8
    assert "timing.json in its folder is used" in caplog.text


def test_labels_are_whole_numbers(tmp_path: Path) -> None:
    path = meta(tmp_path / "a.mha", {"ElementType": "MET_FLOAT"}, np.full(24, 0.25, "<f4").tobytes())
    with pytest.raises(UnreadableFileError, match=r"holds 0\.25; needed labels"):
        read_labels(path)
    with pytest.raises(UnreadableFileError, match=r"holds -1; needed labels, 0 or more"):
        read_labels(meta(path, {"ElementType": "MET_CHAR"}, b"\xff" * 24))


@pytest.mark.parametrize("name", ["a.nii", "a.mha"])
def test_labels_with_a_first_axis_of_one_voxel(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    """As arrays of a network with its channel first are saved: (1, x, y, z)."""
    if name == "a.nii":
        path = nifti(tmp_path / name, 40, "5h", 4, 1, 2, 3, 4)
    else:
        axes = " ".join(map(str, np.eye(4, dtype=int).ravel()))
        shape = {"NDims": "4", "DimSize": "1 2 3 4", "Offset": "0 0 0 0", "ElementSpacing": "1 1 1 1"}
        path = meta(tmp_path / name, {**shape, "TransformMatrix": axes})
    (labels,) = read_labels(path)
    assert labels.values.T.tobytes() == VOXELS or labels.values[..., ::-1].T.tobytes() == VOXELS
    assert "its first axis has one voxel" in caplog.text


@pytest.mark.parametrize("kind", ["int8", "int16", "uint32", "int64", "uint64", "float32", "float64"])
@pytest.mark.parametrize("name", ["a.nrrd", "a.mha", "a.mhd", "a.nhdr"])
@pytest.mark.parametrize("compressed", [False, True])
def test_every_type_as_simpleitk_writes_it(tmp_path: Path, name: str, kind: str, compressed: bool) -> None:
    array = (np.random.default_rng(1).normal(size=(4, 3, 2)) * 100).astype(kind)
    image = SimpleITK.GetImageFromArray(array)
    image.SetSpacing((0.5, 1.5, 2.5))
    SimpleITK.WriteImage(image, str(tmp_path / name), useCompression=compressed)
    found = read_volume(tmp_path / name)
    np.testing.assert_array_equal(found.values, array.T)
    assert found.values.dtype == np.dtype(kind)
    assert found.grid.spacing_mm.tolist() == [0.5, 1.5, 2.5]


def test_bytes_the_other_way_round(tmp_path: Path) -> None:
    values = np.arange(24, dtype=">i2")
    expected = values.reshape(4, 3, 2).T
    big = nrrd(tmp_path / "a.nrrd", {"type": "short", "endian": "big"}, values.tobytes())
    np.testing.assert_array_equal(read_volume(big).values, expected)
    changes = {"ElementType": "MET_SHORT", "BinaryDataByteOrderMSB": "True"}
    big = meta(tmp_path / "a.mha", changes | {"ElementDataFile": "b.raw"})
    (tmp_path / "b.raw").write_bytes(values.tobytes())
    np.testing.assert_array_equal(read_volume(big).values, expected)


def test_voxels_in_several_files(tmp_path: Path) -> None:
    for i in range(4):
        (tmp_path / f"slice{i:02d}.raw").write_bytes(VOXELS[6 * i : 6 * i + 6])
    listed = "LIST\n" + "\n".join(f"slice{i:02d}.raw" for i in range(4))
    for name in ("slice%02d.raw 0 3 1", listed):
        found = read_volume(meta(tmp_path / "a.mhd", {"ElementDataFile": name}, b""))
        assert found.values.T.tobytes() == VOXELS
        found = read_volume(nrrd(tmp_path / "a.nhdr", {"data file": name}, b""))
        assert found.values.T.tobytes() == VOXELS
    (tmp_path / "slice02.raw").write_bytes(bytes(5))
    (tmp_path / "slice03.raw").write_bytes(bytes(7))
    with pytest.raises(UnreadableFileError, match=r"slice02\.raw is truncated"):
        read_volume(tmp_path / "a.mhd")


def test_a_skipped_beginning(tmp_path: Path) -> None:
    (tmp_path / "b.raw").write_bytes(b"head" + VOXELS)
    for skip in ("4", "-1"):
        found = read_volume(meta(tmp_path / "a.mhd", {"HeaderSize": skip, "ElementDataFile": "b.raw"}, b""))
        assert found.values.T.tobytes() == VOXELS
        found = read_volume(nrrd(tmp_path / "a.nhdr", {"byte skip": skip, "data file": "b.raw"}, b""))
        assert found.values.T.tobytes() == VOXELS


def test_packed_voxels_that_unpack_to_more_or_less(tmp_path: Path) -> None:
    for voxels, sentence in ((bytes(25), "longer"), (bytes(23), "truncated"), (bytes(1 << 25), "longer")):
        path = meta(tmp_path / "a.mha", {"CompressedData": "True"}, zlib.compress(voxels))
        with pytest.raises(UnreadableFileError, match=sentence):
            read_volume(path)
    path = meta(tmp_path / "a.mha", {"CompressedData": "True"}, zlib.compress(VOXELS)[:-2])
    with pytest.raises(UnreadableFileError, match="have no end"):
        read_volume(path)


def test_segments_with_damaged_numbers(tmp_path: Path) -> None:
    path = nrrd(tmp_path / "a.seg.nrrd", {"space origin": "(1,2,3)\nSegment0_LabelValue:=x"})
    with pytest.raises(UnreadableFileError, match="Segment0_LabelValue is 'x'"):
        read_label_names(path)


def test_every_segment_of_a_header_is_read_or_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Numbers with a gap, as a deleted segment leaves; the header of Slicer 4.10 and before; no segment."""

    def segments(keys: str, base: dict[str, str] = NRRD, voxels: bytes = b"\1\2\3" + bytes(21)) -> list[int]:
        path = nrrd(tmp_path / "a.seg.nrrd", {"space origin": f"(1,2,3)\n{keys}"}, voxels, base)
        return np.bincount(read_labels(path)[0].values.ravel(), minlength=4).tolist()

    gap = "Segment0_ID:=a\nSegment0_LabelValue:=1\nSegment2_ID:=c\nSegment2_Name:=lv\nSegment2_LabelValue:="
    assert segments(f"{gap}2") == [22, 1, 1, 0]
    assert "1 voxels of layer 0 have a value of no segment" in caplog.text
    assert segments(f"{gap}4") == [23, 1, 0, 0]
    assert "segment 'lv' is empty" in caplog.text
    layers = b"\1" + bytes(24) + b"\1" + bytes(22)
    assert segments("Segment0_ID:=a\nSegment1_ID:=b", NRRD_4D, layers) == [22, 1, 1, 0]
    with pytest.raises(UnreadableFileError, match="fractional segmentation; needed binary labels"):
        segments("Segment0_ID:=a\nSegmentation_MasterRepresentation:=Fractional labelmap")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('{"fractions": [0, 0.5], "rr_s": "0.8"}', "fractions or rr_s are not numbers"),
        ('{"fractions": [0, 0.5], "rr_s": 0.8, "rr_assumed": "false"}', "timing_assumed not true or false"),
        ('{"sax": {"trigger_ms": [[0, 400]], "RR_ms": [800, 810]}}', "needed one RR interval each"),
    ],
)
def test_timing_files_of_other_types(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "timing.json").write_text(text)
    with pytest.raises(UnreadableFileError, match=sentence):
        read_timing(None, folder=tmp_path, phases=2)


def test_doubtful_timing_files_are_noted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "timing.json").write_text('{"fractions": [0, 0.2, 0.4], "rr_s": 0.6, "bpm": 60}')
    assert read_timing(None, folder=tmp_path, phases=3).rr_s == 0.6
    assert "the fields bpm are not known" in caplog.text
    assert "as times in s of its rr_s do" in caplog.text


def test_labels_of_frames_order_them_by_their_numbers(tmp_path: Path) -> None:
    text = "axis 3 index type:=text\naxis 3 index values:=60%25RR 10%25RR"
    path = nrrd(tmp_path / "a.seq.nrrd", {"space origin": f"(1,2,3)\n{text}"}, VOXELS + bytes(24), NRRD_4D)
    series = read_volume_series(path)
    assert [phase.max() for phase in series.values] == [0, 23]
    np.testing.assert_allclose(series.timing.fractions, [0.1, 0.6])


def test_stamps_of_the_volumes_of_a_metafile_are_their_times(tmp_path: Path) -> None:
    axes = " ".join(map(str, np.eye(4, dtype=int).ravel()))
    shape = {"NDims": "4", "DimSize": "2 3 2 2", "Offset": "0 0 0 0", "ElementSpacing": "1 1 1 1"}
    stamps = {"Seq_Frame0000_Timestamp": "7.4", "Seq_Frame0001_Timestamp": "7.0"}
    path = meta(tmp_path / "a.mha", {**shape, "TransformMatrix": axes, **stamps})
    series = read_volume_series(path)
    assert series.values[:, 0, 0, 0].tolist() == [12, 0]
    assert series.timing.rr_s == pytest.approx(0.8)


def test_inspect_names_segments_and_seeds(tmp_path: Path) -> None:
    keys = "Segment0_ID:=a\nSegment0_Name:=lv\nSegment0_LabelValue:=1\nSegment0_Layer:=0"
    path = nrrd(tmp_path / "a.seg.nrrd", {"space origin": f"(1,2,3)\n{keys}"}, b"\1" + bytes(23))
    found = describe(str(path))
    assert (found.kind, found.facts["segments"]) == ("segmentation", {"1": "lv"})
    (tmp_path / "s.json").write_text('{"heart": [[1, 2, 3], [40, 5, 6]], "background": [[90, 5, 6]]}')
    assert describe(str(tmp_path / "s.json")).facts == {"heart": 2, "background": 1, "cavity": 0}
    (tmp_path / "s.json").write_text('{"heart": [[0.001, 0, 0], [0.04, 0, 0]], "background": [[0.09, 0, 0]]}')
    with pytest.raises(UnreadableFileError, match="it is in m"):
        describe(str(tmp_path / "s.json"))
