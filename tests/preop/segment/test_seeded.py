"""Labels from seeds, and the error budget of a surface."""

import json

import numpy as np
import pytest

from dvf_ig.core import (
    FrameMismatchError,
    Grid,
    InvalidInputError,
    Points,
    Seeds,
    UnreadableFileError,
    Volume,
)
from dvf_ig.io import read_seeds
from dvf_ig.preop import dice, segment_from_seeds
from dvf_ig.preop.cine_model import surface_budget
from dvf_ig.preop.segment.seeded import SegmentOptions

OUTER, INNER = 20.0, 12.0


def shell(noise=40.0):
    """Bright blood in a grey wall, in a background of nearly its grey, with a line of fat between."""
    grid = Grid.axis_aligned("mr", (33, 31, 30), (-31.0, -30.0, -29.0), 2.0)
    r = np.linalg.norm(grid.centers_mm(), axis=-1)
    grey = np.where(r < INNER, 800.0, np.where(r < OUTER, 310.0, 250.0)) + 200.0 * (np.abs(r - OUTER - 1) < 1)
    return Volume(grid, grey + noise * np.random.default_rng(2).standard_normal(grey.shape)), r


def axis_points(radius):
    return np.vstack([np.eye(3), -np.eye(3)]) * radius


def seeds(frame="mr"):
    return Seeds(
        Points(frame, axis_points(16.0)), Points(frame, axis_points(26.0)), Points(frame, axis_points(5.0))
    )


def test_a_heart_grows_from_eighteen_points():
    """The outline lies within half a voxel on average: Dice of two balls is about 1 − 1.5 ΔR/R."""
    image, r = shell()
    labels = segment_from_seeds(image, seeds()).values
    assert dice(labels > 0, r < OUTER) > 1.0 - 1.5 * 1.0 / OUTER
    assert dice(labels == 2, r < INNER) > 0.95
    assert set(np.unique(labels)) == {0, 1, 2}


def test_without_cavity_seeds_all_of_the_heart_is_wall():
    image, r = shell()
    plain = Volume(image.grid, np.where(r < OUTER, 310.0, 150.0))
    given = seeds()
    labels = segment_from_seeds(plain, Seeds(given.heart, given.background, Points("mr", np.zeros((0, 3)))))
    assert dice(labels.values == 1, r < OUTER) > 0.97


@pytest.mark.parametrize(("spacing", "worst_sd"), [((1.5, 1.5, 1.5), 0.15), ((2.0, 2.0, 2.0), 0.2)])
def test_the_budget_of_a_surface(spacing, worst_sd):
    """SD well under a voxel; what smoothing takes is given back to a tenth; σ²/R in closed form."""
    budget = surface_budget(np.array(spacing), 4 / 3 * np.pi * 30.0**3)
    assert budget.radius_mm == pytest.approx(30.0)
    assert 0.0 < budget.voxel_mm < worst_sd
    assert budget.shrinkage_mm == pytest.approx(spacing[0] ** 2 / 30.0)
    assert abs(budget.residual_offset_mm) < 0.35 * budget.shrinkage_mm
    assert budget.chord_mm < 0.03


def test_slices_cost_more_than_voxels():
    volume = 4 / 3 * np.pi * 30.0**3
    thin, thick = (surface_budget(np.array([2.0, 2.0, z]), volume) for z in (2.0, 10.0))
    assert thick.voxel_mm > 2.0 * thin.voxel_mm
    with pytest.raises(InvalidInputError, match="a few voxels"):
        surface_budget(np.full(3, 2.0), 100.0)


def test_seed_files(tmp_path):
    given = {"heart": [[1, 2, 3], [4, 5, 6]], "background": [[7, 8, 9]]}
    plain = tmp_path / "seeds.json"
    plain.write_text(json.dumps(given), encoding="utf-8")
    found = read_seeds(plain)
    np.testing.assert_array_equal(found.heart.xyz_mm, given["heart"])
    assert len(found.cavity) == 0
    points = [
        {"label": label, "position": xyz}
        for label, xyz in (("heart-1", [1, 2, 3]), ("Heart", [4, 5, 6]), ("background_2", [7, 8, 9]))
    ]
    slicer = tmp_path / "seeds.mrk.json"
    markup = {"markups": [{"coordinateSystem": "RAS", "controlPoints": points}]}
    slicer.write_text(json.dumps(markup), encoding="utf-8")
    np.testing.assert_array_equal(read_seeds(slicer).heart.xyz_mm, [[-1, -2, 3], [-4, -5, 6]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"heart": [[1, 2, 3]]}', "no seed is named background"),
        ('{"hart": [[1, 2, 3]]}', "named 'hart'"),
        ('{"heart": [[1, 2]]}', "not rows of x, y, z"),
        ("[1, 2]", "needed an object"),
        ("{", "not a file of seeds"),
    ],
)
def test_bad_seed_files(tmp_path, text, message):
    path = tmp_path / "seeds.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableFileError, match=message):
        read_seeds(path)


def test_refusals():
    image, _ = shell()
    near = Seeds(
        Points("mr", axis_points(16.0)), Points("mr", axis_points(17.0)), Points("mr", axis_points(5.0))
    )
    with pytest.raises(InvalidInputError, match="one of another name"):
        segment_from_seeds(image, near)
    far = Seeds(Points("mr", [[500, 0, 0]]), Points("mr", axis_points(26.0)), Points("mr", np.zeros((0, 3))))
    with pytest.raises(InvalidInputError, match="outside the image"):
        segment_from_seeds(image, far)
    with pytest.raises(FrameMismatchError):
        segment_from_seeds(image, seeds("tracker"))
    with pytest.raises(InvalidInputError, match="must be positive"):
        SegmentOptions(beta=0.0)
