"""The pre-operative heart in each form that a lab has it: each is read, and gives a model."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from toy_lab import SESSION, write_lab
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import CycleTiming, DvfModel, Grid, NotConvergedError, Scenario, SurfaceSeries, VolumeSeries
from dvf_ig.io import write_surface_series, write_timing, write_volume, write_volume_series

BLOOD, WALL = 3, 2
RADII_MM = ((18.0, 26.0), (13.0, 23.0), (16.0, 25.0))
TIMING = CycleTiming(np.array([0.0, 0.35, 0.7]), 0.85)


def labels() -> VolumeSeries:
    """A ball of blood in a wall that beat."""
    grid = Grid("mr", (22, 22, 22), np.full(3, -31.5), np.full(3, 3.0), np.eye(3))
    index = np.stack(np.meshgrid(*[np.arange(22)] * 3, indexing="ij"), axis=-1)
    away_mm = np.linalg.norm(index * 3.0 - 31.5, axis=-1)
    phases = [
        np.where(away_mm < inner, BLOOD, np.where(away_mm < outer, WALL, 0)) for inner, outer in RADII_MM
    ]
    return VolumeSeries(grid, np.stack(phases).astype(np.uint8), TIMING)


@pytest.fixture(scope="module")
def files(ball: DvfModel, beating_sphere: SurfaceSeries, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    write_lab(folder, ball)
    series = labels()
    grey = np.choose(np.minimum(series.values, 3), [40, 0, 120, 220]).astype(np.int16)
    write_volume_series(VolumeSeries(series.grid, grey, TIMING), folder / "cine.nrrd")
    write_volume_series(series, folder / "labels.nrrd")
    write_volume(series.phase(0), folder / "ed.nrrd")
    write_timing(TIMING, folder / "timing.json")
    write_surface_series(beating_sphere, folder / "surfaces")
    return folder


@pytest.fixture
def given(files: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Scenario, DvfModel]]:
    """The recordings and the model that would be registered; the working directory is the lab's."""
    found: list[tuple[Scenario, DvfModel]] = []

    def keep(scenario: Scenario, *_: object, model: DvfModel, **__: object) -> None:
        found.append((scenario, model))
        raise NotConvergedError("the work began")

    def run(*arguments: str) -> tuple[Scenario, DvfModel]:
        done = CliRunner().invoke(app, ["register", *arguments])
        assert done.exit_code == 6, done.output
        return found.pop()

    monkeypatch.chdir(files)
    monkeypatch.setattr("dvf_ig.replay.registration.recorded_ultrasound", keep)
    return run


CAVITY = {"cavity_labels": [3]}
HEARTS: dict[str, tuple[dict[str, Any], set[str]]] = {
    "a model": ({"model": "heart.npz"}, set()),
    "a model and its cine": ({"model": "heart.npz", "mr": "cine.nrrd"}, {"mr"}),
    "labels of every phase": ({"labels": "labels.nrrd", **CAVITY}, {"labels"}),
    "a cine with labels of every phase": (
        {"mr": "cine.nrrd", "labels": "labels.nrrd", **CAVITY},
        {"mr", "labels"},
    ),
    "a cine with labels of end-diastole": (
        {"mr": "cine.nrrd", "labels": "ed.nrrd", **CAVITY},
        {"mr", "ed_labels"},
    ),
}


@pytest.mark.parametrize("kind", HEARTS)
def test_a_heart_of_a_session(
    kind: str, given: Callable[..., tuple[Scenario, DvfModel]], files: Path
) -> None:
    heart, there = HEARTS[kind]
    (files / "session.yaml").write_text(yaml.safe_dump(SESSION | {"preop": heart}))
    scenario, model = given("session.yaml", "-o", "out")
    preop = scenario.preop
    assert {name for name in ("mr", "labels", "ed_labels") if getattr(preop, name) is not None} == there
    assert preop.patient_id == model.patient_id
    if "labels" in heart:
        assert preop.organ_labels == ((WALL, BLOOD) if "labels" in there else ())
        vertices = model.reference[model.ed_phase].vertices_mm
        assert np.linalg.norm(vertices, axis=1).mean() == pytest.approx(RADII_MM[0][1], abs=1.0)


def test_surfaces_in_a_session(given: Callable[..., tuple[Scenario, DvfModel]], files: Path) -> None:
    document: dict[str, Any] = SESSION | {"preop": {"surfaces_folder": "surfaces"}, "patient_id": "ball"}
    (files / "session.yaml").write_text(yaml.safe_dump(document))
    scenario, model = given("session.yaml", "-o", "out")
    assert [series.name for series in scenario.preop.surfaces] == ["EPICARDIAL"]
    assert model.surface_name == "EPICARDIAL"
