"""Pairs of 3-D images that are no hearts: what is looked at, known-pose recovery, and what is refused."""

from functools import lru_cache
from time import perf_counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_brain import Brain, brain_mr, brain_ultrasound, displaced, targets, true_pose

from dvf_ig.core import Grid, InvalidInputError, NoOverlapError, Rigid, Stop, Volume
from dvf_ig.registration import ModelChannels, register_pair, target_errors_mm
from dvf_ig.registration.pair_check import mirrored
from dvf_ig.registration.pair_images import (
    EROSION_MM,
    anatomy_around,
    extent_mm,
    fan_volume,
    share_inside,
    usable_voxels,
)

HERE = Rigid.identity("moving", "fixed")
MIDDLE = np.array([30.0, -20.0, 12.0])
SLOPE = np.array([2.0, -1.0, 3.0])


def oblique(frame: str, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> Grid:
    """A turned grid about MIDDLE."""
    direction = Rotation.from_euler("zyx", [25, -15, 40], degrees=True).as_matrix()
    origin = MIDDLE - direction @ (np.array(spacing) * (np.array(shape) - 1) / 2)
    return Grid(frame, shape, origin, np.array(spacing), direction)


def ramp(grid: Grid) -> np.ndarray:
    """A linear function of the place in mm: averages of it are its value at the average place."""
    return 500.0 + (grid.centers_mm() - MIDDLE) @ SLOPE


def ball(radius_mm: float = 18.0) -> Volume:
    """A ramp in a ball with a dark core, 0 outside."""
    grid = oblique("fixed", (60, 50, 32), (0.8, 1.0, 1.5))
    away = np.linalg.norm(grid.centers_mm() - MIDDLE, axis=-1)
    return Volume(grid, np.where((away < radius_mm) & (away > 5.0), ramp(grid), 0.0))


def test_the_fan_is_what_is_not_zero_with_its_dark_core_and_eroded() -> None:
    image = ball()
    usable = usable_voxels(image, None)
    assert extent_mm(image, usable) == pytest.approx(36.0, abs=2.0)
    fan = fan_volume(image, usable, 1.0)
    places = fan.grid.centers_mm()
    away = np.linalg.norm(places - MIDDLE, axis=-1)
    # half a voxel's diagonal of the image, 1 mm, and half a pitch
    assert fan.insonified[away < 18.0 - EROSION_MM - 1.5].all()
    assert not fan.insonified[away > 18.0 - EROSION_MM + 1.5].any()
    assert (fan.values[away < 3.0] < 0.01).all()  # in standard deviations; what the blur carries inwards
    between = fan.insonified & (away > 8.0) & (away < 13.0)
    ratio = fan.values[between] / (500.0 + (places[between] - MIDDLE) @ SLOPE)
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=1e-3)


def test_a_fan_cut_off_by_the_box_keeps_what_touches_it() -> None:
    grid = oblique("fixed", (20, 22, 24), (1.0, 1.0, 1.0))
    full = Volume(grid, ramp(grid))
    assert fan_volume(full, usable_voxels(full, None), 1.0).insonified.all()


def test_the_anatomy_is_cut_to_what_matters_and_stays_in_its_place() -> None:
    grid = oblique("moving", (120, 130, 90), (0.6, 0.6, 1.2))
    moving = Volume(grid, ramp(grid))
    image = ball()
    fan = fan_volume(image, usable_voxels(image, None), 1.6)
    part = anatomy_around(moving, fan, HERE, 10.0)
    assert part.values.size < moving.values.size / 8
    np.testing.assert_allclose(part.grid.spacing_mm, [1.2, 1.2, 1.2])
    np.testing.assert_allclose(part.values, ramp(part.grid), atol=1e-2)
    low, high = part.grid.to_index(fan.grid.centers_mm()[fan.insonified]).min(0), np.array(part.grid.shape)
    assert (low > 0).all()
    assert (part.grid.to_index(fan.grid.centers_mm()[fan.insonified]).max(0) < high - 1).all()
    assert share_inside(moving, fan, HERE) == 1.0


def test_a_mirrored_model_is_the_model_at_mirrored_places() -> None:
    grid = oblique("moving", (24, 20, 16), (1.0, 1.5, 2.0))
    values = np.stack([ramp(grid), ramp(grid) ** 2], axis=-1)[None].astype(np.float32)
    center = MIDDLE + np.array([1.3, -2.1, 0.7])
    for axis in range(3):
        there = mirrored(ModelChannels(grid, values, np.zeros(1)), axis, center)
        normal = grid.direction[:, axis]
        places = there.grid.centers_mm()
        reflected = places - 2 * ((places - center) @ normal)[..., None] * normal
        np.testing.assert_allclose(there.values[0, ..., 0], 500 + (reflected - MIDDLE) @ SLOPE, rtol=1e-5)


@lru_cache
def small_pair(seed: int, shift_mm: float) -> tuple[Volume, Volume]:
    """A brain 60 mm wide: ultrasound and MR."""
    brain = Brain(seed, scale=0.5)
    return brain_ultrasound(brain, true_pose(), shift_mm=shift_mm), brain_mr(brain)


@pytest.mark.parametrize(("seed", "start_mm"), [(11, 3.0), (12, 10.0)])
def test_recovers_a_brain(seed: int, start_mm: float) -> None:
    ultrasound, mr = small_pair(seed, shift_mm=0.0)
    at = targets(ultrasound, true_pose())
    start = displaced(true_pose(), at, start_mm, seed)
    assert target_errors_mm(start, true_pose(), at).mean() == pytest.approx(start_mm, rel=0.02)
    result = register_pair(ultrasound, mr, start, rng=np.random.default_rng(0), clock=perf_counter)
    assert result.stop is Stop.CONVERGED
    assert target_errors_mm(result.target_from_source, true_pose(), at).mean() < 0.3  # a third of a voxel
    assert result.success_probability is not None
    assert result.success_probability > 0.9


def test_another_brain_is_not_called_a_success() -> None:
    ultrasound, mr = small_pair(11, shift_mm=0.0)[0], small_pair(12, shift_mm=0.0)[1]
    start = displaced(true_pose(), targets(ultrasound, true_pose()), 4.0, 1)
    result = register_pair(ultrasound, mr, start, rng=np.random.default_rng(0), clock=perf_counter)
    assert not result.stop.usable
    assert result.success_probability is not None
    assert result.success_probability < 0.5


def test_misuse_says_what_to_do() -> None:
    image, grid = ball(), oblique("moving", (40, 40, 40), (1.0, 1.0, 1.0))
    moving, rng = Volume(grid, ramp(grid)), np.random.default_rng(0)
    away = Rigid("moving", "fixed", np.eye(3), np.array([300.0, 0, 0]))
    with pytest.raises(NoOverlapError, match=r"0 % of the ultrasound .* give a start with --init"):
        register_pair(image, moving, away, rng=rng, clock=perf_counter)
    dark = Volume(image.grid, np.zeros(image.grid.shape))
    with pytest.raises(InvalidInputError, match="no non-zero voxel"):
        register_pair(dark, moving, HERE, rng=rng, clock=perf_counter)
    flat = Volume(image.grid, np.ones(image.grid.shape))
    with pytest.raises(InvalidInputError, match="one value throughout"):
        register_pair(flat, moving, HERE, rng=rng, clock=perf_counter)
    holed = np.where(np.arange(40) == 20, np.nan, ramp(grid))
    with pytest.raises(InvalidInputError, match="voxels of the moving image are no numbers"):
        register_pair(image, Volume(grid, holed), HERE, rng=rng, clock=perf_counter)
    elsewhere = Grid("fixed", image.grid.shape, image.grid.origin_mm + 5, image.grid.spacing_mm, np.eye(3))
    with pytest.raises(InvalidInputError, match="resample the mask onto the fixed image's grid"):
        register_pair(
            image,
            moving,
            HERE,
            rng=rng,
            clock=perf_counter,
            mask=Volume(elsewhere, np.ones(image.grid.shape)),
        )
