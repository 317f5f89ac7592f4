"""`dvf-ig model check MODEL --labels FILE@PHASE` as a user types it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app
from dvf_ig.core import CycleTiming, Grid, SurfaceSeries, Volume, VolumeSeries
from dvf_ig.io import write_model, write_volume, write_volume_series
from dvf_ig.preop import ModelOptions, model_from_surfaces

RADII_MM = (20.0, 17.0, 18.5)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [*map(str, arguments)])


def found(*arguments: object) -> dict[str, Any]:
    done = run(*arguments, "--json")
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout))


@pytest.fixture(scope="module")
def folder(beating_sphere: SurfaceSeries, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The model of a ball at 0, 0.3 and 0.7 of the cycle; labels (2) of its phases, each and all."""
    here = tmp_path_factory.mktemp("checked")
    options = ModelOptions(knot_spacing_mm=5.0, margin_mm=8.0)
    write_model(model_from_surfaces(beating_sphere, options=options), here / "ball.npz")
    grid = Grid.axis_aligned("mr", (28, 28, 28), np.full(3, -27.0), 2.0)
    r = np.linalg.norm(grid.centers_mm(), axis=-1)
    phases = np.stack([np.where(r < radius, 2, 0).astype(np.uint8) for radius in RADII_MM])
    write_volume(Volume(grid, phases[1]), here / "es@1.nii.gz")
    write_volume_series(VolumeSeries(grid, phases, beating_sphere.timing), here / "all.nrrd")
    two = VolumeSeries(grid, phases[:2], CycleTiming.uniform(2, 0.8))
    write_volume_series(two, here / "two.nrrd")
    (here / "text.nrrd").write_text("no image")
    return here


@pytest.mark.parametrize(
    ("labels", "fraction"),
    [("es@1.nii.gz@1", 0.3), ("es@1.nii.gz@0.3", 0.3), ("all.nrrd@2", 0.7), ("all.nrrd@0.96", 0.0)],
)
def test_labels_of_a_phase_agree_with_the_model(folder: Path, labels: str, fraction: float) -> None:
    told = found("model", "check", folder / "ball.npz", "--labels", folder / labels)["labels"]
    assert told["phase"] == pytest.approx(fraction)
    assert told["dice"] > 0.98
    assert told["mean_mm"] < 0.4
    assert told["mean_mm"] <= told["p95_mm"] < 0.8
    for direction in ("model_to_labels_mm", "labels_to_model_mm"):
        assert told[direction]["mean"] < 0.4
    expected = 20.0 - RADII_MM[[0.0, 0.3, 0.7].index(fraction)]
    assert told["end_diastole"]["mean_mm"] == pytest.approx(expected, abs=0.3)


def test_the_table_names_both_errors(folder: Path) -> None:
    done = run("model", "check", folder / "ball.npz", "--labels", folder / "es@1.nii.gz@1")
    assert done.exit_code == 0, done.output
    assert "spline fit error" in done.stdout
    assert "anatomical error" in done.stdout
    assert "end-diastolic surface agrees better" not in done.stderr


def test_a_place_at_which_the_motion_is_worse_than_none_is_told(folder: Path, tmp_path: Path) -> None:
    grid = Grid.axis_aligned("mr", (28, 28, 28), np.full(3, -27.0), 2.0)
    inside = np.linalg.norm(grid.centers_mm(), axis=-1) < RADII_MM[0]
    write_volume(Volume(grid, inside.astype(np.uint8)), tmp_path / "ed.nii.gz")
    done = run("model", "check", folder / "ball.npz", "--labels", tmp_path / "ed.nii.gz@1")
    assert done.exit_code == 0, done.output
    assert "end-diastolic surface agrees better with these labels" in done.stderr


@pytest.mark.parametrize(
    ("labels", "more", "code", "message"),
    [
        ("es@1.nii.gz", (), 2, "needed FILE@PHASE"),
        ("all.nrrd", (), 2, "needed FILE@PHASE"),
        ("all.nrrd@1.0", (), 2, "needed FILE@PHASE"),
        ("all.nrrd@-1", (), 2, "needed FILE@PHASE"),
        ("all.nrrd@nan.", (), 2, "needed FILE@PHASE"),
        ("all.nrrd@end", (), 2, "needed FILE@PHASE"),
        ("@0.3", (), 2, "needed FILE@PHASE"),
        ("all.nrrd@1", ("--organ", "2,b"), 2, "needed whole numbers"),
        (None, ("--organ", "2"), 2, "--organ needs --labels"),
        ("all.nrrd@3", (), 3, "the model has phases 0 to 2"),
        ("two.nrrd@1", (), 3, "labels of 2 phases, the model 3"),
        ("all.nrrd@1", ("--organ", "7"), 3, "no voxel of the organ labels [7]"),
        ("none.nrrd@1", (), 3, "does not exist"),
        ("text.nrrd@1", (), 3, "is not a readable image"),
    ],
)
def test_refusals(folder: Path, labels: str | None, more: tuple[str, ...], code: int, message: str) -> None:
    given = () if labels is None else ("--labels", f"{folder}/{labels}" if labels[0] != "@" else labels)
    done = run("model", "check", folder / "ball.npz", *given, *more)
    assert done.exit_code == code, done.output
    assert message in " ".join(done.output.replace("│", " ").split())
    assert code != 3 or len(done.stderr.strip().splitlines()) == 1
