"""Baselines on a blob of known pose: they recover it, turn about any centre, and say what failed."""

import importlib.util

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import Grid, InvalidInputError, Rigid, Volume
from dvf_ig.study.registration.baselines import MattesOptions, elastix, mattes

CENTER_MM = np.array([40.0, -15.0, 25.0])
TRUTH = Rigid.from_rotation_vector([0.25, -0.15, 0.3], [8.0, 5.0, -12.0], "moving", "fixed")
QUICK = MattesOptions(shrink=(2, 1), smoothing_mm=(2.0, 0.5))


def _anatomy(xyz_mm: np.ndarray) -> np.ndarray:
    """Three lobes of different brightness, frame "moving"."""
    q = xyz_mm - CENTER_MM
    out = np.zeros(q.shape[:-1])
    for level, middle, radii in (
        (60, (0, 0, 0), (24, 18, 20)),
        (90, (6, 4, 2), (9, 7, 12)),
        (40, (-9, -5, 5), 6),
    ):
        out += level / (1 + np.exp(4 * (np.linalg.norm((q - middle) / radii, axis=-1) - 1)))
    return out


def _pair() -> tuple[Volume, Volume, Volume]:
    """Fixed, its mask and moving, on grids turned against each other; the fixed one has inverted contrast."""
    turned = Rotation.from_euler("xyz", [10, -20, 15], degrees=True).as_matrix()
    moving_grid = Grid(
        "moving", (36, 32, 34), CENTER_MM - turned @ np.array([35.0, 31.0, 33.0]), np.full(3, 2.0), turned
    )
    moving = Volume(moving_grid, _anatomy(moving_grid.centers_mm()).astype(np.float32))
    middle = TRUTH.inverse().apply_array(CENTER_MM)
    grid = Grid.axis_aligned("fixed", (33, 33, 33), middle - 32.0, 2.0)
    seen = _anatomy(TRUTH.apply_array(grid.centers_mm()))
    noise = np.random.default_rng(3).normal(0, 4, seen.shape)
    mask = np.linalg.norm(grid.centers_mm() - middle, axis=-1) < 30
    fixed = np.where(mask, 220.0 - seen + noise, 0)
    return Volume(grid, fixed.astype(np.float32)), Volume(grid, mask.astype(np.uint8)), moving


def _error_mm(pose: Rigid | None) -> float:
    assert pose is not None
    points = CENTER_MM + 15 * np.vstack([np.eye(3), -np.eye(3)])
    return float(np.linalg.norm(pose.apply_array(TRUTH.inverse().apply_array(points)) - points, axis=1).max())


def _start() -> Rigid:
    return TRUTH.perturbed_left([0.04, 0.05, -0.03], [2.0, -2.0, 1.5], CENTER_MM)


def test_mattes_recovers_a_clean_pair_and_repeats_itself() -> None:
    fixed, mask, moving = _pair()
    found = mattes(fixed, mask, moving, _start(), CENTER_MM, options=QUICK)
    assert _error_mm(_start()) > 3.0
    assert _error_mm(found.moving_from_fixed) < 0.5  # a quarter of a voxel
    assert found.name == "mattes"
    assert found.seconds > 0
    again = mattes(fixed, mask, moving, _start(), CENTER_MM, options=QUICK)
    assert found.moving_from_fixed is not None
    assert again.moving_from_fixed is not None
    np.testing.assert_array_equal(found.moving_from_fixed.matrix, again.moving_from_fixed.matrix)


def test_mattes_without_a_step_returns_the_start_whatever_the_centre() -> None:
    fixed, mask, moving = _pair()
    still = MattesOptions(shrink=(2,), smoothing_mm=(2.0,), step_mm=1e-9, least_step_mm=1e-10, iterations=1)
    for center in (CENTER_MM, CENTER_MM + 300.0):
        found = mattes(fixed, mask, moving, _start(), center, options=still).moving_from_fixed
        assert found is not None
        np.testing.assert_allclose(found.matrix, _start().matrix, atol=1e-6)


def test_a_start_beside_the_image_gives_no_pose_and_says_why() -> None:
    fixed, mask, moving = _pair()
    away = TRUTH.perturbed_left(np.zeros(3), [500.0, 0, 0], CENTER_MM)
    found = mattes(fixed, mask, moving, away, CENTER_MM, options=QUICK)
    assert found.moving_from_fixed is None
    assert found.note.startswith("no pose: ")


def test_mask_on_another_grid_or_empty_is_refused() -> None:
    fixed, mask, moving = _pair()
    small = Grid.axis_aligned("fixed", (5, 5, 5), np.zeros(3), 1.0)
    for wrong in (Volume(small, np.ones((5, 5, 5))), Volume(mask.grid, np.zeros(mask.grid.shape))):
        with pytest.raises(InvalidInputError, match="on the fixed image's grid that is not empty"):
            mattes(fixed, wrong, moving, _start(), CENTER_MM)
        with pytest.raises(InvalidInputError, match="on the fixed image's grid that is not empty"):
            elastix(fixed, wrong, moving, _start(), CENTER_MM)


def test_elastix_recovers_the_pair_or_says_that_it_is_absent() -> None:
    found = elastix(*_pair(), _start(), CENTER_MM)
    if importlib.util.find_spec("itk") is None:
        assert found.moving_from_fixed is None
        assert found.note == "absent: the package itk-elastix is not installed"
    else:
        assert _error_mm(found.moving_from_fixed) < 0.5
