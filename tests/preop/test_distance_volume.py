"""The signed distance of a phase as an image that SimpleITK reads: the ball's, at its known place."""

import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from toy_ball import CENTERS, KNOT, ORIGIN, RADII
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel
from dvf_ig.io import write_model
from dvf_ig.io.writing.listing import LISTING
from dvf_ig.preop import SplineField


@pytest.fixture(scope="module")
def exported(ball: DvfModel, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    folder = tmp_path_factory.mktemp("exported")
    write_model(ball, folder / "ball.npz")
    arguments = ["model", "export", str(folder / "ball.npz"), "--format", "nrrd", "-o", str(folder / "out")]
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert done.exit_code == 0, done.output
    return folder / "out", json.loads(done.stdout)


def test_one_image_a_phase_says_what_it_holds(exported: tuple[Path, dict[str, object]]) -> None:
    folder, report = exported
    assert report["files"] == [f"EPICARDIAL_distance_{i:03d}.nrrd" for i in range(4)]
    assert sorted(path.name for path in folder.iterdir() if path.name != LISTING) == report["files"]
    assert report["content"] == "signed distance in mm, positive inside"
    assert (report["frame"], report["space"]) == ("mr", "LPS")


def test_every_voxel_lies_at_its_known_place(
    exported: tuple[Path, dict[str, object]], ball: DvfModel
) -> None:
    image = SimpleITK.ReadImage(str(exported[0] / "EPICARDIAL_distance_001.nrrd"))
    assert image.GetSize() == (61, 61, 61)
    for index in ((0, 0, 0), (60, 60, 60), (7, 31, 50)):
        known = ORIGIN + 0.5 * KNOT * np.array(index)
        np.testing.assert_allclose(image.TransformIndexToPhysicalPoint(index), known, atol=1e-6)
        there, _ = SplineField.of_model(ball, 1).at(known[None] * (1 - 1e-12))
        assert image[index] == pytest.approx(there[0], abs=1e-5)


@pytest.mark.parametrize("phase", range(4))
def test_the_zero_level_is_the_balls_surface(exported: tuple[Path, dict[str, object]], phase: int) -> None:
    """Within the fit's 0.01 mm and linear interpolation, h²/4R = 0.02 mm at h = 1 mm, R = 13 mm."""
    image = SimpleITK.ReadImage(str(exported[0] / f"EPICARDIAL_distance_{phase:03d}.nrrd"))
    directions = np.random.default_rng(5).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for depth_mm in (0.0, 3.0, -3.0):
        places = CENTERS[phase] + (RADII[phase] - depth_mm) * directions
        found = [image.EvaluateAtPhysicalPoint(place, SimpleITK.sitkLinear) for place in places.tolist()]
        np.testing.assert_allclose(found, depth_mm, atol=0.035)
