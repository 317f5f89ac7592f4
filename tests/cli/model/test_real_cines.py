"""Real cines to a checked model, as a user types it: with an expert's labels, or with fitted surfaces."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app
from dvf_ig.core import CycleTiming, Grid, SurfaceSeries
from dvf_ig.io import read_model, read_surface_series, read_volume_series, write_timing, write_volume
from dvf_ig.preop import CHAMBER_SURFACES, rasterise


def run(*arguments: object) -> Result:
    done = CliRunner().invoke(app, [*map(str, arguments)])
    assert done.exit_code == 0, done.output
    return done


def found(*arguments: object) -> dict[str, Any]:
    return dict(json.loads(run(*arguments, "--json").stdout))


def at_phases(folder: Path, *phases: int) -> dict[str, SurfaceSeries]:
    """The fitted surfaces, at these phases alone."""
    found = {}
    for name in ("EPICARDIAL", *CHAMBER_SURFACES):
        whole = read_surface_series(folder, name)
        timing = CycleTiming(whole.timing.fractions[list(phases)], whole.timing.rr_s)
        found[name] = SurfaceSeries(
            name, whole.frame, whole.vertices_mm[list(phases)], whole.triangles, timing, whole.patient_id
        )
    return found


def about_the_heart(labels: SimpleITK.Image) -> tuple[slice, slice]:
    """Pixels of the heart and 15 beside it, as a user would crop them."""
    inside = np.argwhere(SimpleITK.GetArrayViewFromImage(labels) > 0)[:, :0:-1]
    low, high = np.maximum(inside.min(axis=0) - 15, 0).tolist(), (inside.max(axis=0) + 16).tolist()
    return slice(low[0], high[0]), slice(low[1], high[1])


@pytest.fixture(scope="module")
def expert(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every sixth frame and second pixel of a real cine, cropped to the heart; frame 2 is end-systole."""
    here, source = tmp_path_factory.mktemp("acdc"), data_dir / "acdc-cine" / "patient008"
    if not source.is_dir():
        pytest.skip(f"no cine at {source}")
    ed, es = (SimpleITK.ReadImage(str(source / f"{name}_labels.nii.gz")) for name in ("ed", "es"))
    x, y = about_the_heart(ed)
    grey = SimpleITK.ReadImage(str(source / "cine_4d.nii.gz"))
    SimpleITK.WriteImage(grey[x, y, :, 0:28:6][::2, ::2], str(here / "cine.nii.gz"))
    for name, labels in (("ed", ed), ("es", es)):
        SimpleITK.WriteImage(labels[x, y, :][::2, ::2], str(here / f"{name}.nii.gz"))
    return here


def test_from_a_real_cine_to_a_checked_model_in_two_commands(expert: Path, tmp_path: Path) -> None:
    model = tmp_path / "heart.npz"
    build = ("model", "build", "--image", expert / "cine.nii.gz", "--labels", expert / "ed.nii.gz")
    built = found(*build, "--cavity", "3,1", "--knot-mm", 6, "-o", model)
    assert built["chambers"] == ["label 3", "label 1"]
    assert built["es_fraction"] == pytest.approx(0.4)
    told = found("model", "check", model, "--labels", f"{expert / 'es.nii.gz'}@2")["labels"]
    assert told["dice"] > told["end_diastole"]["dice"]
    assert told["mean_mm"] < told["end_diastole"]["mean_mm"]


def test_a_cine_that_lost_its_voxel_size_is_refused_before_anything_is_written(
    expert: Path, tmp_path: Path
) -> None:
    """As four of these cines come: seven slices of 10 mm with 1 mm in their headers."""
    for name in ("cine", "ed"):
        image = SimpleITK.ReadImage(str(expert / f"{name}.nii.gz"))
        image.SetSpacing([1.0] * image.GetDimension())
        SimpleITK.WriteImage(image, str(tmp_path / f"{name}.nii.gz"))
    files = ("--image", tmp_path / "cine.nii.gz", "--labels", tmp_path / "ed.nii.gz")
    done = CliRunner().invoke(app, [*map(str, ("model", "build", *files, "-o", tmp_path / "heart.npz"))])
    assert done.exit_code == 3
    assert "7 voxels of 1 mm thick; give more slices, or check the voxel size" in " ".join(
        done.stderr.split()
    )
    assert not list(tmp_path.glob("heart*"))


@pytest.fixture(scope="module")
def bivme(data_dir: Path) -> Path:
    folder = data_dir / "bivme-cine"
    if not folder.is_dir():
        pytest.skip(f"no cine at {folder}")
    return folder


def test_fitted_surfaces_of_a_real_heart_give_a_model_with_its_ventricles(
    bivme: Path, tmp_path: Path
) -> None:
    """Checked with what SimpleITK writes of the fitted surface at end-systole."""
    built = found("model", "build", "--surfaces", bivme, "--knot-mm", 8, "-o", tmp_path / "heart.npz")
    assert built["patient_id"] == "patient1"
    assert built["chambers"] == list(CHAMBER_SURFACES)
    assert built["es_fraction"] == pytest.approx(0.36)
    surfaces = at_phases(bivme, 0, 9)
    low = surfaces["EPICARDIAL"].vertices_mm.min(axis=(0, 1)) - 10
    labels = rasterise(surfaces, Grid.axis_aligned("mr", (80, 70, 80), low, 2.0))
    write_volume(labels.phase(1), tmp_path / "es.nrrd")
    checked = found(
        *("model", "check", tmp_path / "heart.npz", "--labels", f"{tmp_path}/es.nrrd@0.36"),
        *("--surfaces", bivme),
    )
    own = checked["surfaces"]["end_systole"]
    assert own["phase"] == own["surface_phase"] == 9
    assert own["seen_mm"]["mean"] < 1e-6
    told = checked["labels"]
    assert told["dice"] > 0.98
    assert told["mean_mm"] < 0.4


def test_a_real_cine_with_distant_slices_gives_a_model_and_says_what_is_missing(
    bivme: Path, tmp_path: Path
) -> None:
    """Labels of end-diastole are the fitted surfaces' in the short-axis stack; every fifth frame and every
    second pixel are used."""
    image = read_volume_series(bivme / "sax_4d.nii.gz")
    labels = rasterise(at_phases(bivme, 0, 9), image.grid)
    write_volume(labels.phase(0), tmp_path / "whole.nii.gz")
    ed = SimpleITK.ReadImage(str(tmp_path / "whole.nii.gz"))
    grey = SimpleITK.ReadImage(str(bivme / "sax_4d.nii.gz"))
    x, y = about_the_heart(ed)
    SimpleITK.WriteImage(grey[x, y, :, 0:25:5][::2, ::2], str(tmp_path / "cine.nii.gz"))
    SimpleITK.WriteImage(ed[x, y, :][::2, ::2], str(tmp_path / "ed.nii.gz"))
    write_timing(CycleTiming(image.timing.fractions[::5], image.timing.rr_s), tmp_path / "timing.json")
    done = run(
        *("model", "build", "--image", tmp_path / "cine.nii.gz", "--labels", tmp_path / "ed.nii.gz"),
        *("--cavity", 2, "--patient", "patient1", "--knot-mm", 8, "-o", tmp_path / "heart.npz"),
    )
    assert "slices lie 17.7 mm apart" in done.stderr
    assert "the motion folds" not in done.stderr
    model = read_model(tmp_path / "heart.npz", "patient1")
    assert model.timing.rr_s == pytest.approx(0.829, abs=0.001)
    assert [chamber.name for chamber in model.chambers] == ["label 2"]
    assert 0.2 < model.es_fraction < 0.5
    assert "uncertain there by that of adults, 12 ± 3 mm" in " ".join(done.stderr.split())
    assert model.seen is not None
    # 7 mm beyond the slices at either end of 106 mm, and the flat ends
    assert 0.12 < model.unseen_share < 0.25
