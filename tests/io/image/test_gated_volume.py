"""Gated volumes from files: places in the cycle, grey levels of any pixel type, sectors; misuse refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from scipy import ndimage
from scipy.spatial.transform import Rotation

from dvf_ig.core import AnyArray, Grid, InvalidInputError, TrackedVolume, UnreadableFileError, Volume
from dvf_ig.intake import describe
from dvf_ig.io import GatedVolumeFile, gated_volume_files, read_gated_volumes, sequence_volumes, write_volume
from dvf_ig.io.image.gated_volume import insonified_voxels

SHAPE = (30, 34, 26)
TURN = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()


def sector(shape: tuple[int, int, int] = SHAPE, *, turn_rad: float = 0.0) -> AnyArray:
    """A cone about the second axis, its tip at the border: where a matrix array sees."""
    q = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1) - (
        shape[0] / 2,
        1.0,
        shape[2] / 2,
    )
    q = q @ Rotation.from_rotvec([turn_rad, 0, 0]).as_matrix()
    return np.asarray((np.linalg.norm(q, axis=-1) < 28) & (np.hypot(q[..., 0], q[..., 2]) < 0.6 * q[..., 1]))


def image(seed: int = 1, *, seen: AnyArray | None = None, dark: float = 0.3) -> AnyArray:
    """Speckle in a sector, a share of it black."""
    rng = np.random.default_rng(seed)
    grey = rng.integers(1, 256, SHAPE).astype(np.uint8) * (rng.random(SHAPE) > dark)
    return np.where(sector() if seen is None else seen, grey, 0).astype(np.uint8)


def written(path: Path, values: AnyArray, *, shift_mm: float = 0.0) -> Path:
    grid = Grid("tracker", SHAPE, np.array([-20.0 + shift_mm, 40, 7]), np.array([0.6, 0.6, 1.2]), TURN)
    write_volume(Volume(grid, values), path)
    return path


def read(paths: list[Path], phases: list[float]) -> tuple[TrackedVolume, ...]:
    files = [GatedVolumeFile(path, phase) for path, phase in zip(paths, phases, strict=True)]
    return read_gated_volumes(sequence_volumes(files), phases)


@pytest.mark.parametrize(
    ("text", "name", "phase", "t_s"),
    [
        ("us.nrrd@0.35", "us.nrrd", 0.35, None),
        ("a b/us@2=x.nrrd@0", "a b/us@2=x.nrrd", 0.0, None),
        ("us.nii.gz@.999", "us.nii.gz", 0.999, None),
        ("us.mha=12.25", "us.mha", None, 12.25),
        ("us=3@4.mha=-1e1", "us=3@4.mha", None, -10.0),
    ],
)
def test_a_file_says_when_it_was_taken(text: str, name: str, phase: float | None, t_s: float | None) -> None:
    (file,) = gated_volume_files([text])
    assert (file.path, file.phase, file.t_s) == (Path(name), phase, t_s)


@pytest.mark.parametrize("text", ["us.nrrd", "us.nrrd@", "us.nrrd@35%", "@0.3", "us.nrrd=", "", "us@x.nrrd"])
def test_a_file_without_its_time_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError, match="does not say its phase"):
        gated_volume_files(["other.nrrd@0", text])


@pytest.mark.parametrize("phase", ["1", "1.2", "-0.1", "35", "nan", "inf"])
def test_a_phase_outside_the_cycle_is_refused(phase: str) -> None:
    with pytest.raises(InvalidInputError, match="fraction of the RR interval"):
        gated_volume_files([f"us.nrrd@{phase}"])


def test_a_time_that_is_no_time_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="finite"):
        gated_volume_files(["us.nrrd=nan"])


@pytest.mark.parametrize("second", ["us.nrrd@0.5", "./us.nrrd@0.1", "x/../us.nrrd=3"])
def test_a_file_named_twice_is_refused(second: str) -> None:
    with pytest.raises(InvalidInputError, match="twice"):
        gated_volume_files(["us.nrrd@0.1", second])


@pytest.mark.parametrize("convert", [np.uint8, np.int16, np.uint16, np.float32, np.float64, "share", "nan"])
def test_any_pixel_type_gives_the_same_volume(tmp_path: Path, convert: str | type) -> None:
    grey = image()
    if convert == "share":
        stored = (grey / 255.0).astype(np.float32)
    elif convert == "nan":
        stored = np.where(sector(), grey, np.nan).astype(np.float32)
    else:
        stored = grey.astype(convert)
    (volume,) = read([written(tmp_path / "us.nrrd", stored)], [0.25])
    np.testing.assert_array_equal(volume.image.values, grey)
    assert volume.image.values.dtype == np.uint8
    assert volume.model_phase == 0.25


@pytest.mark.parametrize("ending", ["nrrd", "mha", "nii.gz"])
def test_the_header_places_it_in_the_trackers_lps_coordinates(tmp_path: Path, ending: str) -> None:
    """Written by SimpleITK alone: one bright voxel, its physical point."""
    made = SimpleITK.Image([9, 8, 7], SimpleITK.sitkUInt8)
    made.SetSpacing([0.6, 0.8, 1.2])
    made.SetDirection(TURN.ravel().tolist())
    made.SetOrigin([-31.0, 12.0, 77.0])
    made[5, 2, 3] = 200
    SimpleITK.WriteImage(made, str(tmp_path / f"us.{ending}"))
    (volume,) = read([tmp_path / f"us.{ending}"], [0.0])
    bright = np.argwhere(volume.image.values == 200).astype(float)
    place = volume.tracker_from_image.apply_array(volume.image.grid.to_mm(bright))
    assert volume.tracker_from_image.target == "tracker"
    np.testing.assert_allclose(place, [made.TransformIndexToPhysicalPoint([5, 2, 3])], atol=1e-4)


@pytest.mark.parametrize("turn_rad", [0.0, 0.5])
def test_dark_voxels_inside_the_sector_were_insonified_and_black_ones_around_it_were_not(
    turn_rad: float,
) -> None:
    seen = sector(turn_rad=turn_rad)
    found = insonified_voxels(image(seen=seen, dark=0.08))
    assert not (found & ~seen).any()
    # voxels of the border itself, one in twelve of them black, are where it can be missed
    border = seen & ~ndimage.binary_erosion(seen)
    assert (seen & ~found).sum() < 0.05 * border.sum()
    assert not (seen & ~found & ~border).any()
    hollow = border  # as if all within were dark blood
    np.testing.assert_array_equal(insonified_voxels(hollow), seen)


def test_images_of_one_sector_share_what_was_insonified(tmp_path: Path) -> None:
    """A corner that one image shows dark is known from the other."""
    second = image(2)
    second[:, 28:, :] = 0
    files = [
        written(tmp_path / "a.nrrd", image(1, dark=0.0)),
        written(tmp_path / "b.nrrd", second, shift_mm=3.0),
    ]
    assert insonified_voxels(second).sum() < 0.99 * sector().sum()
    for volume in read(files, [0.0, 0.5]):
        np.testing.assert_array_equal(volume.mask.values, sector())


def test_views_resampled_to_one_grid_keep_their_own_sectors(tmp_path: Path) -> None:
    other = sector(turn_rad=0.5)
    files = [
        written(tmp_path / "a.nrrd", image(1, dark=0.0)),
        written(tmp_path / "b.nrrd", image(2, seen=other, dark=0.0)),
    ]
    first, second = read(files, [0.0, 0.5])
    np.testing.assert_array_equal(first.mask.values, sector())
    np.testing.assert_array_equal(second.mask.values, other)


def several(path: Path) -> None:
    SimpleITK.WriteImage(SimpleITK.Image([5, 5, 5, 3], SimpleITK.sitkUInt8), str(path))


def listed(path: Path) -> None:
    """A sequence as 3D Slicer stores it: a list of values at each voxel."""
    path.write_bytes(
        b"NRRD0004\ntype: unsigned char\ndimension: 4\nspace: left-posterior-superior\nsizes: 2 3 3 3\n"
        b"space directions: none (1,0,0) (0,1,0) (0,0,1)\nkinds: list domain domain domain\n"
        b"encoding: raw\nspace origin: (0,0,0)\n\n" + bytes(54)
    )


def echo(path: Path, times: str, unit: str, label: str = "time") -> Path:
    """4-D echo as SlicerHeart saves it; volume i is 10 (i + 1) everywhere."""
    count = len(times.split())
    voxels = np.broadcast_to(10 * (1 + np.arange(count, dtype=np.uint8)), (3, 3, 3, count))
    path.write_bytes(
        f"NRRD0005\ntype: unsigned char\ndimension: 4\nspace: left-posterior-superior\nsizes: {count} 3 3 3\n"
        f"space directions: none (1,0,0) (0,1,0) (0,0,1)\nkinds: list domain domain domain\n"
        f'labels: "{label}" "" "" ""\nunits: "{unit}" "" "" ""\nencoding: raw\nspace origin: (0,0,0)\n'
        f"axis 0 index type:=numeric\naxis 0 index values:={times}\n\n".encode()
        + voxels.tobytes()
    )
    return path


def test_a_4d_echo_is_its_volumes_at_their_times(tmp_path: Path) -> None:
    path = echo(tmp_path / "us.seq.nrrd", "0 80 40 160", "ms")
    files = sequence_volumes([GatedVolumeFile(path, t_s=12.0)])
    np.testing.assert_allclose([file.t_s or 0 for file in files], [12.0, 12.04, 12.08, 12.16])
    volumes = read_gated_volumes(files, [0.1, 0.2, 0.3, 0.4])
    assert [int(volume.image.values[1, 1, 1]) for volume in volumes] == [10, 30, 20, 40]
    assert [volume.model_phase for volume in volumes] == [0.1, 0.2, 0.3, 0.4]


def test_a_4d_echo_of_more_or_less_than_a_cycle_is_described(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    facts = describe(str(echo(tmp_path / "us.seq.nrrd", "0 40 80", "ms"))).facts
    assert (facts["volumes"], "rr_s" in facts) == (3, False)
    assert "a cycle of 0.12 s" in caplog.text


def test_a_gated_4d_echo_is_its_volumes_at_their_phases(tmp_path: Path) -> None:
    path = echo(tmp_path / "us.seq.nrrd", "0 25 50", "", "%R-R")
    files = sequence_volumes(gated_volume_files([f"{path}@0.9"]))
    np.testing.assert_allclose([file.phase or 0 for file in files], [0.9, 0.15, 0.4])


@pytest.mark.parametrize(
    ("times", "unit", "placed", "says"),
    [
        ("0 40 80", "s", {"t_s": 1.0}, "40 s apart"),
        ("0 40 80", "ms", {"phase": 0.0}, "write FILE=SECONDS"),
        ("0 40 80", "%", {"t_s": 1.0}, "write FILE@PHASE"),
        ("0 40 140", "%", {"phase": 0.0}, "fractions of one RR interval"),
        ("0 40 40", "ms", {"t_s": 1.0}, "a time of its own"),
        ("0 40", "furlong", {"t_s": 1.0}, "is in 'furlong'"),
        ("0 1 2", "", {"phase": 0.1}, "is in ''; needed times in s or ms: state the unit"),
    ],
)
def test_a_4d_echo_whose_times_are_none_is_refused(
    tmp_path: Path, times: str, unit: str, placed: dict[str, float], says: str
) -> None:
    path = echo(tmp_path / "us.seq.nrrd", times, unit)
    with pytest.raises(UnreadableFileError, match=says):
        sequence_volumes([GatedVolumeFile(path, **placed)])


def colours(path: Path) -> None:
    SimpleITK.WriteImage(SimpleITK.Image([5, 5, 5], SimpleITK.sitkVectorUInt8), str(path))


def bright(path: Path) -> None:
    written(path, image().astype(np.int16) * 16)


def decibels(path: Path) -> None:
    written(path, image().astype(np.float32) - 60)


def black(path: Path) -> None:
    written(path, np.zeros(SHAPE, dtype=np.uint8))


def planes(path: Path) -> None:
    SimpleITK.WriteImage(SimpleITK.Image([5, 5, 5], SimpleITK.sitkUInt8), str(path))
    path.write_bytes(path.read_bytes().replace(b"NDims", b"Seq_Frame0000_Status = OK\nNDims", 1))


@pytest.mark.parametrize(
    ("make", "name", "says"),
    [
        (several, "us.nii.gz", "several volumes without their times; split it"),
        (listed, "us.seq.nrrd", "several volumes without their times; split it"),
        (colours, "us.nrrd", "needed 3-D with one"),
        (bright, "us.nrrd", "from 0 to 4080; needed log-compressed"),
        (decibels, "us.nrrd", "from -60"),
        (black, "us.nrrd", "black throughout"),
        (planes, "us.mha", "tracked sequence"),
        (lambda _: None, "us.nrrd", "does not exist"),
        (lambda path: path.write_text("no image"), "us.nrrd", "not a readable image"),
    ],
)
def test_what_is_no_volume_is_refused_by_name(
    tmp_path: Path, make: Callable[[Path], object], name: str, says: str
) -> None:
    make(tmp_path / name)
    with pytest.raises(UnreadableFileError, match=says) as refused:
        read([tmp_path / name], [0.0])
    assert name in str(refused.value)
