"""Ultrasound of labelled volumes: a small synthetic one, and the real whole heart."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
import typer
from typer.testing import CliRunner

from data_synth.heart.tissue import Tissue
from data_synth.ultrasound.label_anatomy import LabelAnatomy, label_anatomy
from data_synth.ultrasound.presets import PROBES
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.sequence import simulate_frame
from data_synth.ultrasound.views import standard_view, view_from
from dvf_ig.cli.synth.ultrasound import us
from dvf_ig.core import AnyArray, Grid, InvalidInputError, Volume

app = typer.Typer()
app.command("us")(us)
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def two_chambers() -> Volume:
    """LV (3) in myocardium (1) below an LA (2), on an oblique grid whose axes are not the patient's."""
    grid = Grid("mr", (50, 44, 60), [5.0, -7.0, 3.0], [1.5, 1.5, 1.5], TURN)
    i, j, k = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    values = np.zeros(grid.shape, dtype=np.int16)
    lv = ((i - 24) / 14) ** 2 + ((j - 22) / 14) ** 2 + ((k - 20) / 18) ** 2
    la = ((i - 24) / 11) ** 2 + ((j - 22) / 11) ** 2 + ((k - 46) / 10) ** 2
    values[la < 1] = 2
    values[lv < 1] = 1
    values[lv < 0.45] = 3
    return Volume(grid, values)


@cache
def made() -> LabelAnatomy:
    return label_anatomy(two_chambers())


def codes_at(anatomy_codes: AnyArray, origin: AnyArray, xyz: AnyArray) -> AnyArray:
    index = np.rint(xyz - origin).astype(int)
    return anatomy_codes[tuple(index.T)]


def test_tissues_stand_where_the_labels_do() -> None:
    labels = two_chambers()
    reference = made().reference
    centers = labels.grid.to_mm(np.array([[24.0, 22, 20], [24, 22, 46], [24, 34, 20]]))
    found = codes_at(reference.inner, reference.origin_mm, centers)
    assert found.tolist() == [Tissue.LV_BLOOD, Tissue.LA_BLOOD, Tissue.LV_MYOCARDIUM]
    outside = labels.grid.to_mm(np.array([[24.0, 22, 20]])) + np.array([[40.0, 0, 0]])
    assert codes_at(reference.outer, reference.origin_mm, outside)[0] == Tissue.MEDIASTINUM


def test_bare_blood_gets_a_wall_and_the_heart_fat_and_pericardium() -> None:
    labels = two_chambers()
    reference = made().reference
    inside = reference.organ_mm > 0
    wall = inside & (reference.inner == Tissue.ATRIAL_WALL)
    assert 1500 < wall.sum() < 9000  # mm³: about 2 mm around an atrium of 16 mm radius, less the valve's side
    assert {Tissue.FAT, Tissue.PERICARDIUM, Tissue.MEDIASTINUM} <= set(np.unique(reference.outer[~inside]))
    # walking out of the atrium: blood, wall, fat, pericardium
    start = labels.grid.to_mm(np.array([[24.0, 22.0, 46.0]]))
    way = start + np.arange(0.0, 24.0, 0.5)[:, None] * np.array([1.0, 0.0, 0.0])
    index = np.rint(way - reference.origin_mm).astype(int)
    codes = np.where(inside, reference.inner, reference.outer)[tuple(index.T)]
    order = codes[np.flatnonzero(np.diff(codes, prepend=-1))].tolist()
    assert order[:4] == [Tissue.LA_BLOOD, Tissue.ATRIAL_WALL, Tissue.FAT, Tissue.PERICARDIUM]


def test_blood_is_dark_and_myocardium_bright_in_the_image() -> None:
    labels = two_chambers()
    anatomy = made()
    probe = PROBES["epicardial"]
    assert isinstance(probe, SectorProbe)
    lv = labels.grid.to_mm(np.array([24.0, 22.0, 20.0]))
    pose = view_from(lv - np.array([0.0, 60.0, 0.0]), lv, 0.3)
    image = simulate_frame(anatomy, probe, pose, np.zeros(probe.lines), seed=1, frame=0)

    def grey(depth_mm: float) -> float:
        row = round(probe.apex_px[1] + depth_mm / probe.mm_per_px[1])
        return float(image[row - 6 : row + 6, 165:178].mean())

    assert grey(43.0) > grey(60.0) + 50
    assert grey(77.0) > grey(60.0) + 50


def test_missing_chambers_and_odd_labels_are_refused() -> None:
    labels = two_chambers()
    with pytest.raises(InvalidInputError, match="rv_blood"):
        standard_view("apical four-chamber", made().reference)
    with pytest.raises(InvalidInputError, match="choose from apical"):
        standard_view("from afar", made().reference)
    with pytest.raises(InvalidInputError, match="no voxel carries"):
        label_anatomy(labels, {9: Tissue.LIVER})
    with pytest.raises(InvalidInputError, match="fractions"):
        label_anatomy(Volume(labels.grid, labels.values * 0.5))


def written(labels: Volume, path: Path) -> Path:
    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(labels.values.T))
    image.SetOrigin(labels.grid.origin_mm.tolist())
    image.SetSpacing(labels.grid.spacing_mm.tolist())
    image.SetDirection(labels.grid.direction.ravel().tolist())
    SimpleITK.WriteImage(image, str(path))
    return path


def test_command_writes_pictures_and_placed_volumes(tmp_path: Path) -> None:
    source = written(two_chambers(), tmp_path / "labels.nrrd")
    names = tmp_path / "tissues.yaml"
    names.write_text("1: lv_myocardium\n2: la_blood\n3: lv_blood\n")
    place = ["--eye", "-30", "-35", "40", "--tissues", str(names), "--probe", "ice"]
    for target in ("a.png", "b.nrrd"):
        done = CliRunner().invoke(
            app, ["--labels", str(source), *place, "--json", "-o", str(tmp_path / target)]
        )
        assert done.exit_code == 0, done.output
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    image = SimpleITK.ReadImage(str(tmp_path / "b.nrrd"))
    assert image.GetSize() == (512, 512, 1)
    ice = PROBES["ice"]
    assert isinstance(ice, SectorProbe)
    apex = image.TransformContinuousIndexToPhysicalPoint((*ice.apex_px, 0.0))
    assert np.allclose(apex, [-30, -35, 40], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--probe", "sonar"], 3, "choose from epicardial"),
        (["--probe", "matrix"], 3, "does not fit a .png"),
        (["--view", "apical four-chamber", "--eye", "0", "0", "0"], 2, "exclude each other"),
        (["--roll-deg", "5"], 2, "belong to --eye"),
        (["--tissues", "missing.yaml"], 3, "does not exist"),
    ],
)
def test_impossible_requests_end_with_one_sentence(
    tmp_path: Path, options: list[str], code: int, words: str
) -> None:
    source = written(two_chambers(), tmp_path / "labels.nrrd")
    done = CliRunner().invoke(app, ["--labels", str(source), *options, "-o", str(tmp_path / "x.png")])
    assert done.exit_code == code
    assert words in " ".join(done.output.replace("│", " ").split())


def test_the_real_whole_heart(data_dir: Path, tmp_path: Path) -> None:
    """Apical view: left ventricle, septum and right ventricle in their order along a row."""
    source = data_dir / "heartdeform-wh" / "wh.nii.gz"
    out = tmp_path / "wh.png"
    done = CliRunner().invoke(app, ["--labels", str(source), "-o", str(out), "--seed", "2"])
    assert done.exit_code == 0, done.output
    image = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(out)))
    probe = PROBES["apical"]
    assert isinstance(probe, SectorProbe)
    assert image.shape == (probe.rows, probe.columns)
    inside = probe.fan.mask(*image.shape)
    dark, bright = np.percentile(image[inside], [25, 90])
    assert bright > dark + 60
    assert not image[~inside].any()
