"""Images: known shifts read by SimpleITK, geometry kept to the last bit, sheared grids refused."""

import gzip
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvf_ig.core import (
    CycleTiming,
    Grid,
    InvalidInputError,
    OutputError,
    UnreadableFileError,
    Volume,
    VolumeSeries,
)
from dvf_ig.io import read_volume, read_volume_series, write_timing, write_volume, write_volume_series

Same = Callable[..., None]
ENDINGS = ["nrrd", "mha", "nii.gz"]


def volume(seed: int, *, oblique: bool, dtype: type = np.float32) -> Volume:
    rng = np.random.default_rng(seed)
    turned = Rotation.random(rng=rng).as_matrix() if oblique else np.eye(3)
    grid = Grid("mr", (5, 4, 3), rng.normal(size=3) * 80, rng.uniform(0.3, 9, 3), turned)
    return Volume(grid, (rng.normal(size=(5, 4, 3)) * 100).astype(dtype))


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32), oblique=st.booleans(), ending=st.sampled_from(["nrrd", "mha"]))
def test_round_trip_is_exact(
    tmp_path_factory: pytest.TempPathFactory, assert_same: Same, seed: int, oblique: bool, ending: str
) -> None:
    one = volume(seed, oblique=oblique)
    path = tmp_path_factory.mktemp("case") / f"v.{ending}"
    write_volume(one, path)
    assert_same(read_volume(path), one)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("ending", ENDINGS)
def test_pixel_types_are_kept(tmp_path: Path, ending: str, dtype: type) -> None:
    one = volume(3, oblique=True, dtype=dtype)
    write_volume(one, tmp_path / f"v.{ending}")
    back = read_volume(tmp_path / f"v.{ending}")
    assert back.values.dtype == dtype
    np.testing.assert_array_equal(back.values, one.values)
    np.testing.assert_allclose(back.grid.origin_mm, one.grid.origin_mm, rtol=1e-6)


@pytest.mark.parametrize("ending", ENDINGS)
def test_known_shift_read_by_simpleitk(tmp_path: Path, ending: str) -> None:
    values = np.zeros((4, 5, 6), np.uint8)
    values[3, 1, 2] = 200
    write_volume(
        Volume(Grid.axis_aligned("mr", (4, 5, 6), (10, 20, 30), (1, 2, 4)), values), tmp_path / f"v.{ending}"
    )
    image = SimpleITK.ReadImage(str(tmp_path / f"v.{ending}"))
    assert image[3, 1, 2] == 200
    np.testing.assert_allclose(image.TransformIndexToPhysicalPoint((3, 1, 2)), (13, 22, 38), atol=1e-5)


@pytest.mark.parametrize("ending", ENDINGS)
def test_simpleitk_image_is_read_where_it_lies(tmp_path: Path, ending: str) -> None:
    array = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    image = SimpleITK.GetImageFromArray(array)
    image.SetOrigin((-7, 3, 11))
    image.SetSpacing((0.5, 1.5, 2.5))
    turned = Rotation.from_euler("xyz", (10, 20, 30), degrees=True).as_matrix()
    image.SetDirection(turned.ravel().tolist())
    SimpleITK.WriteImage(image, str(tmp_path / f"v.{ending}"))
    back = read_volume(tmp_path / f"v.{ending}", frame="ct")
    assert back.grid.frame == "ct"
    index = (3, 2, 1)
    assert back.values[index] == array[1, 2, 3]
    np.testing.assert_allclose(
        back.grid.to_mm(np.array(index, float)), image.TransformIndexToPhysicalPoint(index), atol=1e-5
    )


def test_left_handed_grid_keeps_every_voxel_in_place(tmp_path: Path) -> None:
    array = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    image = SimpleITK.GetImageFromArray(array)
    image.SetDirection((1, 0, 0, 0, -1, 0, 0, 0, 1))
    image.SetOrigin((4, 5, 6))
    SimpleITK.WriteImage(image, str(tmp_path / "v.nrrd"))
    back = read_volume(tmp_path / "v.nrrd")
    assert np.linalg.det(back.grid.direction) == pytest.approx(1)
    for index in np.ndindex(4, 3, 2):
        at = np.round(back.grid.to_index(np.array(image.TransformIndexToPhysicalPoint(index)))).astype(int)
        assert back.values[tuple(at)] == array[index[::-1]]


@pytest.mark.parametrize("ending", ENDINGS)
def test_series(tmp_path: Path, ending: str) -> None:
    one = volume(5, oblique=False, dtype=np.int16)
    timing = CycleTiming(np.array([0.0, 0.4]), 0.9)
    series = VolumeSeries(one.grid, np.stack([one.values, one.values + 1]), timing)
    path = tmp_path / f"v.{ending}"
    write_volume_series(series, path)
    image = SimpleITK.ReadImage(str(path))
    assert image.GetSize() == (5, 4, 3, 2)
    assert image[2, 1, 0, 1] == int(one.values[2, 1, 0]) + 1
    np.testing.assert_array_equal(read_volume_series(path, timing).values, series.values)
    assumed = read_volume_series(path).timing
    assert assumed.rr_assumed
    assert assumed.timing_assumed
    write_timing(timing, tmp_path / "timing.json")
    beside = read_volume_series(path).timing
    assert beside.fractions.tolist() == [0.0, 0.4]
    assert not beside.rr_assumed
    with pytest.raises(InvalidInputError, match="2 phases, its timing 3"):
        read_volume_series(path, CycleTiming.uniform(3, 1.0))
    with pytest.raises(UnreadableFileError, match=r"4-D .* needed 3-D"):
        read_volume(path)


def test_real_cine_and_its_trigger_times(data_dir: Path) -> None:
    series = read_volume_series(data_dir / "bivme-cine" / "sax_4d.nii.gz")
    assert series.values.shape == (25, 256, 208, 6)
    assert series.values.dtype == np.int16
    assert series.timing.rr_s == pytest.approx(np.mean([831, 814, 776, 829, 860, 863]) / 1000)
    np.testing.assert_allclose(series.timing.fractions, np.arange(25) / 25, atol=1e-9)
    chamber = read_volume_series(data_dir / "bivme-cine" / "lax_4ch_a.nii.gz")
    assert chamber.timing.rr_s == pytest.approx(0.876)


def nifti(
    path: Path, *, sform: np.ndarray, code: int = 1, q_code: int = 0, wide: bool = False, order: str = "<"
) -> None:
    """A 2×2×2 uint8 NIfTI-1 (or -2) file with the given 3×4 sform."""
    header = bytearray(544 if wide else 352)
    if wide:
        struct.pack_into(f"{order}i8sHH", header, 0, 540, b"n+2\0\r\n\x1a\n", 2, 8)
        struct.pack_into(f"{order}8q", header, 16, 3, 2, 2, 2, 1, 1, 1, 1)
        struct.pack_into(f"{order}8d", header, 104, 1, 1, 1, 1, 1, 1, 1, 1)
        struct.pack_into(f"{order}q", header, 168, 544)
        struct.pack_into(f"{order}ii", header, 344, q_code, code)
        struct.pack_into(f"{order}12d", header, 400, *sform.ravel())
    else:
        struct.pack_into(f"{order}i", header, 0, 348)
        struct.pack_into(f"{order}8h", header, 40, 3, 2, 2, 2, 1, 1, 1, 1)
        struct.pack_into(f"{order}hh", header, 70, 2, 8)
        struct.pack_into(f"{order}9f", header, 76, 1, 1, 1, 1, 1, 1, 1, 1, 352)
        struct.pack_into(f"{order}hh", header, 252, q_code, code)
        struct.pack_into(f"{order}12f", header, 280, *sform.ravel())
        header[344:348] = b"n+1\0"
    data = bytes(header) + bytes(range(8))
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)


STRAIGHT = np.array([[-1.0, 0, 0, 5], [0, -1, 0, 6], [0, 0, 1, 7]])
SHEARED = STRAIGHT + np.array([[0, 0.3, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])


@pytest.mark.parametrize("name", ["v.nii", "v.nii.gz"])
@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_sheared_nifti_is_refused_with_a_repair(tmp_path: Path, name: str, wide: bool, order: str) -> None:
    nifti(tmp_path / name, sform=SHEARED, wide=wide, order=order)
    with pytest.raises(UnreadableFileError, match=r"sheared \(16\.70° off.*nib-conform v\.nii") as caught:
        read_volume(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["v.nii", "v.nii.gz"])
def test_straight_nifti(tmp_path: Path, name: str) -> None:
    nifti(tmp_path / name, sform=STRAIGHT)
    back = read_volume(tmp_path / name)
    np.testing.assert_allclose(back.grid.to_mm(np.zeros(3)), (-5, -6, 7), atol=1e-6)
    assert back.values[1, 0, 0] == 1


def test_unused_sform_does_not_matter(tmp_path: Path) -> None:
    nifti(tmp_path / "v.nii", sform=SHEARED, code=0, q_code=1)
    assert read_volume(tmp_path / "v.nii").values.shape == (2, 2, 2)


def test_sheared_metaimage_is_refused(tmp_path: Path) -> None:
    header = (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nTransformMatrix = 1 0 0 0.3 0.9539392 0 0 0 1\n"
        "Offset = 0 0 0\nElementSpacing = 1 1 1\nDimSize = 2 2 2\nElementType = MET_UCHAR\n"
        "ElementDataFile = LOCAL\n"
    )
    (tmp_path / "v.mha").write_bytes(header.encode() + bytes(8))
    with pytest.raises(UnreadableFileError, match=r"sheared .*antsApplyTransforms"):
        read_volume(tmp_path / "v.mha")


@pytest.mark.parametrize("name", ["v.nii", "v.nii.gz", "v.nrrd", "v.mha"])
@pytest.mark.parametrize("data", [b"", b"garbage " * 100])
def test_garbage(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(UnreadableFileError, match=name) as caught:
        read_volume(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_truncated(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = rng.integers(0, 255, (20, 20, 20)).astype(np.uint8)
    big = Volume(Grid.axis_aligned("mr", (20, 20, 20), (0, 0, 0), 1.0), values)
    for name in ("v.nii", "v.nii.gz", "v.nrrd", "v.mha"):
        path = tmp_path / name
        write_volume(big, path)
        data = path.read_bytes()
        for keep in (200, 4000, len(data) - 50):
            path.write_bytes(data[:keep])
            with pytest.raises(UnreadableFileError, match=name):
                read_volume(path)


def test_absent_and_unwritable(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_volume(tmp_path / "v.nrrd")
    one = volume(1, oblique=False)
    with pytest.raises(OutputError, match="unknown image ending"):
        write_volume(one, tmp_path / "v.jpg")
    with pytest.raises(OutputError):
        write_volume(one, tmp_path / "nowhere" / "v.nrrd")
    assert list(tmp_path.iterdir()) == []
