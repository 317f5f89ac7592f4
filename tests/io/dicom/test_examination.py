"""One folder of all series of an examination: the stack and its views by geometry, the rest with a reason."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dicom_toy import dicom_image
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import UnreadableFileError
from dvf_ig.io import DicomExamination, read_dicom_examination

pytest.importorskip("pydicom", reason="pydicom writes the DICOM images of these tests")

COLUMNS, ROWS, PHASES, SLICES = 20, 16, 9, 5
SAX = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])
NORMAL = np.cross(SAX[0], SAX[1])
LAX = np.array([[1.0, 0.0, 0.0], NORMAL])
MIDDLE = np.array([10.0, -20.0, 30.0])
PIXEL_MM, PITCH_MM = 2.0, 10.0

Change = Callable[[Any], None]


def image(
    series: str, axes: np.ndarray, middle: np.ndarray, number: int, trigger_ms: float, level: int
) -> Any:
    """One image whose middle lies at a point; every pixel has one grey level."""
    corner = middle - PIXEL_MM * (0.5 * (COLUMNS - 1) * axes[0] + 0.5 * (ROWS - 1) * axes[1])
    key, pixels = f"{series} {middle} {number} {level}", np.full((ROWS, COLUMNS), level)
    data = dicom_image(key, series, pixels, corner, axes, (PIXEL_MM, PIXEL_MM))
    data.InstanceNumber, data.TriggerTime, data.NominalInterval = number, trigger_ms, 900
    return data


def cine(series: str, axes: np.ndarray, middle: np.ndarray, level: int, phases: int = PHASES) -> list[Any]:
    return [image(series, axes, middle, i + 1, 900.0 * i / phases, level + i) for i in range(phases)]


def stack(name: str = "series", phases: int = PHASES) -> list[Any]:
    places = [MIDDLE + PITCH_MM * (k - 0.5 * (SLICES - 1)) * NORMAL for k in range(SLICES)]
    return [one for k, place in enumerate(places) for one in cine(f"{name} {k}", SAX, place, 100 * k, phases)]


def examined(folder: Path, *parts: list[Any]) -> Path:
    """Files in an order and with names that say nothing."""
    folder.mkdir()
    every = [one for part in parts for one in part]
    for k, one in enumerate(every):
        one.save_as(folder / f"IM{(37 * k) % len(every):05d}", enforce_file_format=True)
    return folder


def beside_images() -> list[Any]:
    """What an archive exports along with the slices."""
    names = ("report", "segmentation", "colours", "screen")
    report, segmentation, colours, screen = (image(name, SAX, MIDDLE, 1, 0.0, 0) for name in names)
    del report.PixelData, report.Rows, report.Columns, report.ImagePositionPatient
    report.SOPClassUID = "1.2.840.10008.5.1.4.1.1.88.22"
    report.Modality, segmentation.Modality, colours.SamplesPerPixel = "SR", "SEG", 3
    del screen.ImagePositionPatient, screen.ImageOrientationPatient
    screen.SOPClassUID = "1.2.840.10008.5.1.4.1.1.7"
    return [report, segmentation, colours, screen]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    turned = np.array([[0.0, 0.8, 0.6], NORMAL])
    flow = [*cine("flow", LAX, MIDDLE + 4.0 * SAX[1], 900), *cine("flow", LAX, MIDDLE + 4.0 * SAX[1], 950)]
    scouts = [image("scout", axes, MIDDLE, 1, 0.0, 5) for axes in (SAX, LAX, np.eye(3)[:2])]
    late = stack("enhancement", phases=1)
    beside = cine("beside", SAX, MIDDLE + 3.0 * NORMAL, 700)
    return examined(
        tmp_path_factory.mktemp("exam") / "all",
        scouts,
        stack(),
        late,
        cine("view a", LAX, MIDDLE, 600),
        cine("view b", turned, MIDDLE, 650),
        flow,
        beside,
        beside_images(),
    )


@pytest.fixture(scope="module")
def found(folder: Path) -> DicomExamination:
    return read_dicom_examination(folder)


def test_inspect_says_and_draws_where_the_slices_lie(folder: Path, tmp_path: Path) -> None:
    picture = tmp_path / "slices.png"
    done = CliRunner().invoke(app, ["inspect", str(folder), "-o", str(picture), "--json"])
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["kind"] == "examination of DICOM images"
    assert facts["short_axis"] == {
        "slices": SLICES,
        "pitch_mm": PITCH_MM,
        "phases": PHASES,
        "length_mm": 40.0,
    }
    assert {
        name.split(" ", 1)[1]: one["angle_to_slices_deg"] for name, one in facts["long_axis"].items()
    } == {"view a": pytest.approx(90.0), "view b": pytest.approx(90.0)}
    assert any("whole without it" in one["reason"] for one in facts["left_out"].values())
    assert picture.read_bytes().startswith(b"\x89PNG")
    refused = CliRunner().invoke(app, ["inspect", __file__, "-o", str(picture)])
    assert refused.exit_code == 3


def test_stack_and_views_are_found_by_their_geometry(found: DicomExamination) -> None:
    assert found.patient_id == "heart-9"
    assert found.sax.grid.shape == (COLUMNS, ROWS, SLICES)
    np.testing.assert_allclose(found.sax.grid.direction[:, 2], NORMAL, atol=1e-6)
    middle = found.sax.grid.to_mm((np.array(found.sax.grid.shape) - 1.0) / 2.0)
    np.testing.assert_allclose(middle, MIDDLE, atol=1e-4)
    # slice k at phase i has grey level 100 k + i
    levels = 100 * np.arange(SLICES) + np.arange(PHASES)[:, None]
    np.testing.assert_array_equal(found.sax.values[:, 3, 4, :], levels)
    assert sorted(found.names) == ["view a", "view b"]
    for view in found.views:
        assert view.grid.shape == (COLUMNS, ROWS, 1)
        np.testing.assert_array_equal(np.diff(view.values[:, 0, 0, 0]), 1)
        np.testing.assert_allclose(view.timing.fractions, np.arange(PHASES) / PHASES, atol=1e-9)
        assert view.timing.rr_s == pytest.approx(0.9)


def test_every_other_series_is_left_out_with_a_reason(found: DicomExamination) -> None:
    reasons = {one.series: one.reason for one in found.left_out}
    assert "1 images a slice" in reasons["scout"]
    assert "1 images a slice" in reasons["enhancement 0"]
    assert "two images of trigger time" in reasons["flow"]
    assert "the stack is whole without it" in reasons["beside"]
    assert "SR without pixels" in reasons["report"]
    assert "a segmentation" in reasons["segmentation"]
    assert reasons["colours"] == "colour pictures"
    assert reasons["screen"] == "screen shots"


def test_a_folder_without_a_stack_says_what_it_holds(tmp_path: Path) -> None:
    folder = examined(tmp_path / "few", cine("four chambers", LAX, MIDDLE, 10))
    with pytest.raises(UnreadableFileError, match="no short-axis cine stack"):
        read_dicom_examination(folder)
