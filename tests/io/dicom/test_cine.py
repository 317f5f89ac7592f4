"""A cine of DICOM images, written by pydicom: every voxel at its place and time, and what is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dicom_toy import dicom_image
from scipy.spatial.transform import Rotation

from dvf_ig.core import UnreadableFileError
from dvf_ig.intake import describe
from dvf_ig.io import image_dimension, read_volume_series
from dvf_ig.io.dicom.child import read_tags
from dvf_ig.io.dicom.cine import read_dicom_cine
from dvf_ig.io.dicom.header import read_images
from dvf_ig.io.dicom.stack import CineStack, stack_of

pydicom = pytest.importorskip("pydicom", reason="pydicom writes the DICOM images of these tests")

SLICES, PHASES, COLUMNS, ROWS = 4, 5, 6, 8
AXES = Rotation.from_rotvec([0.3, -0.4, 0.2]).as_matrix()
"""Columns: directions of growing column, growing row, and the normal."""
ORIGIN = np.array([-80.0, 35.5, 120.25])
SPACING = np.array([1.4, 1.6, 9.0])
RR_MS = 800.0 + 10.0 * np.arange(SLICES)

Change = Callable[[Any, int, int], None]


def value(column: int, row: int, number: int, phase: int) -> int:
    return column + 10 * row + 100 * number + 1000 * phase


def image(number: int, phase: int) -> Any:
    """Slice `number` at `phase`: grey levels say where and when."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    pixels = column + 10 * row + 100 * number + 1000 * phase
    corner = ORIGIN + number * SPACING[2] * AXES[:, 2]
    spacing = (float(SPACING[1]), float(SPACING[0]))
    data = dicom_image(f"{number} {phase}", f"series {number}", pixels, corner, AXES[:, :2].T, spacing)
    data.PatientID, data.SeriesDescription, data.SliceThickness = "heart-7", "cine sax", 8.0
    data.InstanceNumber, data.NominalInterval = phase + 1, int(RR_MS[number])
    data.TriggerTime = round(RR_MS[number] * (0.02 + phase / PHASES), 3)
    return data


def write(folder: Path, change: Change | None = None, leave_out: tuple[tuple[int, int], ...] = ()) -> Path:
    """The stack, in an order of names that says nothing about place or time."""
    folder.mkdir()
    for number in range(SLICES):
        within = folder / f"series{(number * 3) % SLICES}"
        within.mkdir()
        for phase in range(PHASES):
            if (number, phase) in leave_out:
                continue
            data = image(number, phase)
            if change is not None:
                change(data, number, phase)
            data.save_as(within / f"IM{(7 * phase + 3) % 11:04d}", enforce_file_format=True)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("dicom") / "cine")


def test_every_voxel_lies_at_its_place_and_time(folder: Path) -> None:
    series = read_volume_series(folder)
    assert series.grid.shape == (COLUMNS, ROWS, SLICES)
    assert series.values.dtype == np.int16
    for column, row, number, phase in ((0, 0, 0, 0), (5, 2, 3, 4), (1, 7, 2, 1)):
        assert series.values[phase, column, row, number] == value(column, row, number, phase)
        expected = ORIGIN + AXES @ (SPACING * (column, row, number))
        place = series.grid.to_mm(np.array([column, row, number], dtype=float))
        np.testing.assert_allclose(place, expected, atol=1e-5)
    np.testing.assert_allclose(series.timing.fractions, 0.02 + np.arange(PHASES) / PHASES, atol=2e-6)
    assert series.timing.rr_s == pytest.approx(RR_MS.mean() / 1000)
    assert not series.timing.rr_assumed
    assert not series.timing.timing_assumed


@pytest.mark.usefixtures("quick")
def test_it_is_the_image_that_simpleitk_reads(folder: Path) -> None:
    """SimpleITK's own series reader orders the slices of a phase; voxels lie where it puts them."""
    import SimpleITK

    cine = read_dicom_cine(folder)
    files = [str(folder / f"series{(n * 3) % SLICES}" / f"IM{(7 * 2 + 3) % 11:04d}") for n in range(SLICES)]
    reader = SimpleITK.ImageSeriesReader()
    reader.SetFileNames(files)
    volume = reader.Execute()
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(volume).T, cine.values[2])
    far = volume.TransformIndexToPhysicalPoint((5, 7, 3))
    np.testing.assert_allclose(cine.grid.to_mm(np.array([5.0, 7, 3])), far, atol=1e-4)


@pytest.mark.usefixtures("quick")
def test_inspect_says_whose_it_is(folder: Path) -> None:
    told = describe(str(folder))
    assert told.kind == "cine of DICOM images"
    assert told.facts["patient_id"] == "heart-7"
    assert (told.facts["phases"], told.facts["size"]) == (PHASES, [COLUMNS, ROWS, SLICES])
    assert told.facts["series"] == ["cine sax"]
    assert image_dimension(folder) == 4


@pytest.mark.usefixtures("quick")
def test_rescale_slope_and_other_files(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def halves(data: Any, number: int, phase: int) -> None:
        data.RescaleSlope, data.RescaleIntercept = 0.5, -1

    written = write(tmp_path / "cine", halves)
    (written / "notes.txt").write_text("not an image")
    (written / "._IM0003").write_bytes(b"\0\5\x16\7" + bytes(200))
    (written / "DICOMDIR").write_bytes(bytes(128) + b"DICM")
    values = read_dicom_cine(written).values
    assert values[1, 3, 2, 1] == 0.5 * value(3, 2, 1, 1) - 1
    assert "1 files that are not DICOM" in caplog.text
    assert "1 files of macOS were skipped, for example ._IM0003" in caplog.text


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tags read in this process."""
    monkeypatch.setattr("dvf_ig.io.dicom.header.read_tags", lambda files: [read_tags(str(f)) for f in files])


def stack(folder: Path) -> CineStack:
    return stack_of(folder, read_images(sorted(path for path in folder.rglob("*") if path.is_file()))[0])


@pytest.mark.usefixtures("quick")
def test_without_trigger_times_the_order_is_that_of_the_instances(tmp_path: Path) -> None:
    def untimed(data: Any, number: int, phase: int) -> None:
        del data.TriggerTime, data.NominalInterval

    found = stack(write(tmp_path / "cine", untimed))
    assert found.timing.timing_assumed
    assert found.timing.rr_assumed
    assert [[image.number for image in row] for row in found.images] == [[1, 2, 3, 4, 5]] * SLICES


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("stated", [(0, 0, 0, 0, 0), (0, 2000, 4000, 6000, 8000), None])
@pytest.mark.parametrize("temporal", [True, False])
def test_trigger_times_of_no_heart_order_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, stated: tuple[int, ...] | None, temporal: bool
) -> None:
    """dcm2niix issues 395, 408, 529: absent, all 0, or starts of scans; instance numbers may be jumbled."""
    jumbled = (3, 1, 5, 2, 4)

    def change(data: Any, number: int, phase: int) -> None:
        data.TriggerTime, data.NominalInterval = (None if stated is None else stated[phase]), 0
        if temporal:
            data.TemporalPositionIdentifier, data.InstanceNumber = phase + 1, jumbled[phase]

    result = stack(write(tmp_path / "cine", change))
    assert [image.path.name for image in result.images[0]] == [
        f"IM{(7 * p + 3) % 11:04d}" for p in range(PHASES)
    ]
    assert result.timing.timing_assumed
    if stated is not None:
        assert "not those of a heart" in caplog.text
        assert ("temporal positions" if temporal else "instance numbers") in caplog.text


def enhanced(path: Path, change: Callable[[Any], None] = lambda data: None) -> Path:
    """The stack as one file, its frames in an order of their own."""
    from pydicom import Dataset
    from pydicom.uid import EnhancedMRImageStorage

    frames = [(phase, number) for phase in reversed(range(PHASES)) for number in range(SLICES)]
    images = [image(number, phase) for phase, number in frames]
    data = image(0, 0)
    data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = EnhancedMRImageStorage
    groups = []
    for one in images:
        group, place, time = Dataset(), Dataset(), Dataset()
        place.ImagePositionPatient = one.ImagePositionPatient
        time.NominalCardiacTriggerDelayTime, time.RRIntervalTimeNominal = one.TriggerTime, one.NominalInterval
        group.PlanePositionSequence, group.CardiacSynchronizationSequence = [place], [time]
        groups.append(group)
    shared, measures, turn = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing, turn.ImageOrientationPatient = data.PixelSpacing, data.ImageOrientationPatient
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [turn]
    moved = (
        "ImagePositionPatient",
        "ImageOrientationPatient",
        "PixelSpacing",
        "TriggerTime",
        "NominalInterval",
    )
    for name in moved:
        delattr(data, name)
    data.SharedFunctionalGroupsSequence, data.PerFrameFunctionalGroupsSequence = [shared], groups
    data.NumberOfFrames, data.PixelData = len(images), b"".join(one.PixelData for one in images)
    change(data)
    data.save_as(path, enforce_file_format=True)
    return path


@pytest.mark.usefixtures("quick")
def test_an_enhanced_file_is_the_classic_stack(tmp_path: Path, folder: Path) -> None:
    classic, one = read_dicom_cine(folder), read_dicom_cine(enhanced(tmp_path / "IM1"))
    np.testing.assert_array_equal(one.values, classic.values)
    np.testing.assert_allclose(one.grid.axes_mm, classic.grid.axes_mm)
    np.testing.assert_allclose(one.grid.origin_mm, classic.grid.origin_mm)
    np.testing.assert_allclose(one.timing.fractions, classic.timing.fractions)
    assert (one.timing.rr_s, one.patient_id) == (classic.timing.rr_s, classic.patient_id)


def _twice(data: Any) -> None:
    data.PixelSpacing = [3.0, 3.0]


def _fewer(data: Any) -> None:
    data.NumberOfFrames -= 1


def _scaled(data: Any) -> None:
    from pydicom import Dataset

    for n, group in enumerate(data.PerFrameFunctionalGroupsSequence):
        scale = Dataset()
        scale.RescaleSlope, scale.RescaleIntercept = 1 + n % 2, 0
        group.PixelValueTransformationSequence = [scale]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_twice, "frame 1 states PixelSpacing as 3.0.*and as 1.6"),
        (_fewer, "holds 19 frames, with positions of 20"),
        (_scaled, "different rescale slopes and intercepts"),
    ],
)
@pytest.mark.usefixtures("quick")
def test_an_enhanced_file_that_contradicts_itself_is_refused(
    tmp_path: Path, change: Callable[[Any], None], message: str
) -> None:
    with pytest.raises(UnreadableFileError, match=message):
        read_dicom_cine(enhanced(tmp_path / "IM1", change))


@pytest.mark.usefixtures("quick")
def test_an_rr_interval_that_cannot_be_is_not_used(tmp_path: Path) -> None:
    def short(data: Any, number: int, phase: int) -> None:
        data.NominalInterval = 500

    timing = stack(write(tmp_path / "cine", short)).timing
    assert timing.rr_assumed
    assert timing.rr_s == pytest.approx(RR_MS.mean() / 1000 * 1.02, rel=1e-3)


def set_in(number: int, **tags: Any) -> Change:
    def change(data: Any, at: int, phase: int) -> None:
        if at == number:
            for name, entry in tags.items():
                setattr(data, name, entry)

    return change


def every(**tags: Any) -> Change:
    def change(data: Any, number: int, phase: int) -> None:
        for name, entry in tags.items():
            setattr(data, name, entry)

    return change


def backward(data: Any, number: int, phase: int) -> None:
    data.TemporalPositionIdentifier = PHASES - phase


def in_seconds(data: Any, number: int, phase: int) -> None:
    data.TriggerTime = round(data.TriggerTime / 1000, 6)


def matrix(data: Any, number: int, phase: int) -> None:
    if number == 2:
        data.Rows, data.PixelData = ROWS - 2, data.PixelData[: 2 * COLUMNS * (ROWS - 2)]


def sideways(data: Any, number: int, phase: int) -> None:
    if number == 2:
        data.ImagePositionPatient = [
            float(a + b) for a, b in zip(data.ImagePositionPatient, 5.0 * AXES[:, 0], strict=True)
        ]


def frames(data: Any, number: int, phase: int) -> None:
    if number == 1:
        data.NumberOfFrames, data.PixelData = 2, data.PixelData * 2


def untimed_slice(data: Any, number: int, phase: int) -> None:
    if number == 1:
        del data.TriggerTime


def cut_short(data: Any, number: int, phase: int) -> None:
    data.PixelData = data.PixelData[:-2]


def through_a_table(data: Any, number: int, phase: int) -> None:
    data.ModalityLUTSequence = [pydicom.Dataset()]


def report(data: Any, number: int, phase: int) -> None:
    data.Modality, data.SOPClassUID = "SR", "1.2.840.10008.5.1.4.1.1.88.22"
    del data.PixelData


def twice(data: Any, number: int, phase: int) -> None:
    data.PixelData = 2 * data.PixelData


def moved_slice(data: Any, number: int, phase: int) -> None:
    if number == 3:
        data.ImagePositionPatient = [float(v) for v in ORIGIN + 3.4 * SPACING[2] * AXES[:, 2]]


@pytest.mark.parametrize(
    ("change", "leave_out", "message"),
    [
        (set_in(1, PatientID="someone else"), (), r"2 patients: 'heart-7', 'someone else'|2 patients: 'some"),
        (set_in(1, FrameOfReferenceUID="1.2.3"), (), "2 frames of reference"),
        (matrix, (), "2 matrix sizes: 6 x 8, 6 x 6|2 matrix sizes: 6 x 6, 6 x 8"),
        (set_in(1, PixelSpacing=[2, 2]), (), "several pixel sizes"),
        (set_in(1, ImageOrientationPatient=[1, 0, 0, 0, 1, 0]), (), "several orientations"),
        (set_in(1, ImageOrientationPatient=[1, 0, 0, 1, 1, 0]), (), "not orthogonal"),
        (None, tuple((1, p) for p in range(PHASES)), "it is 18.0 mm: a slice is missing"),
        (moved_slice, (), "unevenly spaced"),
        (None, ((2, 2),), "a phase is missing in the slice at"),
        (None, ((2, 4),), "has 4 phases, others 5"),
        (set_in(2, TriggerTime=30), (), "two images of trigger time 30 ms"),
        (untimed_slice, (), "5 of 20 images have no trigger time"),
        (sideways, (), "shifted sideways by 5.0 mm"),
        (frames, (), "holds 2 frames, with positions of 1"),
        (set_in(1, SpacingBetweenSlices=12), (), None),
        (
            every(SpacingBetweenSlices=12, SeriesInstanceUID="1.2"),
            (),
            "are 9.00 mm apart .* 12 mm by Spacing",
        ),
        (set_in(1, RescaleSlope=0, RescaleIntercept=5), (), "RescaleSlope .* is not a number other than 0"),
        (every(NumberOfTemporalPositions=6), (), "holds 5 phases, and its images state 6"),
        (backward, (), "by trigger time .* temporal positions .* are 5 and 4"),
        (every(HeartRate=120), (), "800 ms and a heart rate .* of 120 beats"),
        (in_seconds, (), "spans 0.1 % of the RR interval"),
        (set_in(0, PixelSpacing=[1e-9, 1]), (), "pixels have sides"),
        (set_in(1, RescaleSlope="nan", RescaleIntercept=0), (), "RescaleSlope .* is not a number other than"),
        (cut_short, (), "holds 94 bytes of pixels, its header states 96"),
        (through_a_table, (), r"go through a table \(0028,3000\)"),
        (report, (), "no DICOM image of a cine .*SR without pixels"),
        (twice, (), "holds 192 bytes of pixels, its header states 96"),
        (every(BitsStored=12), (), r"12 bits \(0028,0101\), the highest of which is 15"),
        (set_in(1, Modality="US"), (), "2 modalities: MR, US|2 modalities: US, MR"),
        (set_in(1, ImageType=["ORIGINAL", "PRIMARY", "P", "ND"]), (), r"of another kind \(ImageType P\)"),
        (every(ImageType=["ORIGINAL", "PRIMARY", "M", "MOSAIC"]), (), "ImageType MOSAIC"),
        (every(ImageType=["ORIGINAL", "PRIMARY", "M", "ND"]), (), None),
    ],
)
@pytest.mark.filterwarnings("ignore:Invalid value for VR DS")
@pytest.mark.usefixtures("quick")
def test_what_is_no_stack_is_refused_in_one_sentence(
    tmp_path: Path, change: Change | None, leave_out: tuple[tuple[int, int], ...], message: str | None
) -> None:
    written = write(tmp_path / "cine", change, leave_out)
    if message is None:
        assert read_dicom_cine(written).grid.spacing_mm[2] == pytest.approx(SPACING[2])
        return
    with pytest.raises(UnreadableFileError, match=message) as refused:
        read_dicom_cine(written)
    assert "\n" not in str(refused.value)


def test_damaged_files_are_named_and_end_no_process(tmp_path: Path) -> None:
    written = write(tmp_path / "cine")
    file = next((written / "series0").iterdir())
    data = file.read_bytes()
    for broken in (data[:200], data[:-20], data[:132] + bytes(reversed(data[132:400]))):
        file.write_bytes(broken)
        with pytest.raises(UnreadableFileError, match=file.name):
            read_dicom_cine(written)


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="holds no DICOM image"):
        read_volume_series(tmp_path)
