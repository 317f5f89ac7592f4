"""A unit that a file states is heeded: another one is refused. Voxels are finite, and scaled as stated."""

import re
from pathlib import Path

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, InvalidInputError, UnreadableFileError, Volume, VolumeSeries
from dvf_ig.core.space.volume import Grid
from dvf_ig.io import read_cine_labels, read_volume, read_volume_series, write_volume, write_volume_series
from scripts.fuzz_readers import READERS, write_seeds

UNIT = re.compile(rb"(?<![A-Za-z_])(mm|mV|uV|s|rad)(?![A-Za-z_])")
WITH_UNITS = {
    "ecg-edf": "ecg.edf",
    "ecg-wfdb": "r.hea",
    "landmarks": "points.mrk.json",
    "truth": "scenario/truth/truth.json",
}
GRID = Grid.axis_aligned("mr", (4, 5, 6), [0.0, 0.0, 0.0], 1.0)


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seeds")
    write_seeds(folder)
    return folder


@pytest.mark.parametrize("reader", WITH_UNITS)
def test_another_unit_is_refused(seeds: Path, reader: str) -> None:
    path, read = seeds / WITH_UNITS[reader], READERS[reader][1]
    whole = path.read_bytes()
    read(path)
    if reader.startswith("ecg"):
        changed = whole.replace(b"mV", b"m ")
    else:
        unit = UNIT.search(whole, whole.find(b"nits"))
        assert unit is not None
        changed = whole[: unit.start()] + b"m " + whole[unit.end() :]
    assert changed != whole
    path.write_bytes(changed)
    try:
        with pytest.raises(UnreadableFileError):
            read(path)
    finally:
        path.write_bytes(whole)


def test_labels_of_a_heart_in_cm_are_refused(tmp_path: Path) -> None:
    grid = Grid.axis_aligned("mr", (40, 40, 40), [0.0, 0.0, 0.0], 0.15)
    labels = np.zeros(grid.shape, np.uint8)
    labels[5:-5, 5:-5, 5:-5] = 1
    write_volume(Volume(grid, labels), tmp_path / "labels.mha")
    image = VolumeSeries(grid, np.stack([labels, labels]), CycleTiming((0.0, 0.5), 1.0))
    with pytest.raises(InvalidInputError, match=r"4\.5 mm across, and an organ 5 to 1000 mm"):
        read_cine_labels(tmp_path / "labels.mha", image, 0)


@pytest.mark.parametrize("ending", ["mha", "nrrd", "nii.gz"])
def test_infinite_voxels_are_refused(tmp_path: Path, ending: str) -> None:
    """Beside an ultrasound's fan a volume holds NaN; a cine holds none."""
    path, values = tmp_path / f"a.{ending}", np.zeros((2, 4, 5, 6), np.float32)
    for bad, refused in ((np.inf, True), (-np.inf, True), (np.nan, False)):
        values[0, 1, 2, 3] = bad
        write_volume(Volume(GRID, values[0]), path)
        if refused:
            with pytest.raises(UnreadableFileError, match="not finite"):
                read_volume(path)
        else:
            np.testing.assert_array_equal(read_volume(path).values, values[0])
        write_volume_series(VolumeSeries(GRID, values, CycleTiming((0.0, 0.5), 1.0)), path)
        with pytest.raises(UnreadableFileError, match="not finite"):
            read_volume_series(path)


@pytest.mark.parametrize(("slope", "intercept"), [(0.5, 3.0), (1.0, 0.25), (-0.1234567, 1e5), (0.0, 5.0)])
@pytest.mark.parametrize("kind", ["i2", "u1", "f4", "f8"])
def test_scaled_nifti_is_as_itk_scales_it(tmp_path: Path, slope: float, intercept: float, kind: str) -> None:
    """But for a slope of 0, which NIfTI-1 defines as no scaling."""
    import SimpleITK

    path = tmp_path / "a.nii"
    values = np.arange(120).reshape(4, 5, 6).astype(kind)
    write_volume(Volume(GRID, values), path)
    data = path.read_bytes()
    path.write_bytes(data[:112] + np.array([slope, intercept], "<f4").tobytes() + data[120:])
    got = read_volume(path).values
    wanted = values if slope == 0.0 else SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path))).T
    assert got.dtype == wanted.dtype
    np.testing.assert_array_equal(got, wanted)
