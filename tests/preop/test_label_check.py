"""A model against labels of another phase, on balls whose distance to each other is known."""

import numpy as np
import pytest

from dvf_ig.core import DvfModel, Grid, InvalidInputError, SurfaceSeries, Volume
from dvf_ig.preop import LabelCheck, ModelOptions, check_labels, model_from_surfaces

VOXEL_MM = 1.5


@pytest.fixture(scope="module")
def model(beating_sphere: SurfaceSeries) -> DvfModel:
    """Radius 20, 17 and 18.5 mm at 0, 0.3 and 0.7 of the cycle."""
    return model_from_surfaces(beating_sphere, options=ModelOptions(knot_spacing_mm=4.0, margin_mm=10.0))


def ball(radius_mm: float, value: int = 1, half_mm: float = 30.0, shift_mm: float = 0.0) -> Volume:
    count = int(2 * half_mm / VOXEL_MM) + 1
    grid = Grid.axis_aligned("mr", (count,) * 3, np.full(3, -half_mm), VOXEL_MM)
    r = np.linalg.norm(grid.centers_mm() - [shift_mm, 0.0, 0.0], axis=-1)
    return Volume(grid, np.where(r < radius_mm, value, 0).astype(np.uint8))


def checked(model: DvfModel, labels: Volume, fraction: float, organ: tuple[int, ...] = ()) -> LabelCheck:
    return check_labels(
        model, labels, fraction, organ_labels=organ, points=1500, rng=np.random.default_rng(2)
    )


@pytest.mark.parametrize(
    ("fraction", "radius_mm"), [(0.0, 20.0), (0.3, 17.0), (0.15, 18.5), (0.85, 19.25), (0.5, 17.75)]
)
def test_labels_of_the_model_s_own_surface_agree(model: DvfModel, fraction: float, radius_mm: float) -> None:
    """Between phases the distance, and so the radius, is interpolated; across the end of the cycle, too."""
    found = checked(model, ball(radius_mm), fraction)
    assert found.dice > 0.98
    assert found.both_mm.mean() < 0.15 * VOXEL_MM
    assert found.fraction == fraction


def test_another_radius_is_the_distance(model: DvfModel) -> None:
    found = checked(model, ball(17.0), 0.0)
    for distances in (found.model_to_labels_mm, found.labels_to_model_mm):
        assert distances.mean() == pytest.approx(3.0, abs=0.1)
    assert found.dice == pytest.approx(2 * 17**3 / (17**3 + 20**3), abs=0.01)


def test_a_shift_is_half_the_distance_on_average(model: DvfModel) -> None:
    """|s cos θ| averaged over a sphere is s/2; its 95th percentile 0.95 s."""
    found = checked(model, ball(20.0, shift_mm=3.0), 0.0)
    assert found.both_mm.mean() == pytest.approx(1.5, abs=0.12)
    assert np.percentile(found.both_mm, 95) == pytest.approx(2.85, abs=0.15)


def test_walls_that_labels_lack_are_added_as_in_the_model(model: DvfModel) -> None:
    """The right half of the ball is blood of 17 mm radius, whose wall of 3 mm is not labelled."""
    whole = ball(20.0)
    x, y, z = np.moveaxis(whole.grid.centers_mm(), -1, 0)
    blood = (np.hypot(np.hypot(x, y), z) < 17.0) & (x > 2.0)
    values = np.where(blood, 3, np.where(x > 2.0, 0, whole.values)).astype(np.uint8)
    values[np.hypot(np.hypot(x + 8.0, y), z) < 6.0] = 2
    labels = Volume(whole.grid, values)
    rng = np.random.default_rng(2)
    bare, walled = (
        check_labels(model, labels, 0.0, cavity_labels=cavities, points=1500, rng=rng).both_mm.mean()
        for cavities in ((), (2, 3))
    )
    assert walled < 0.6 * bare


def test_only_the_organ_counts(model: DvfModel) -> None:
    both = np.maximum(ball(17.0, 2).values, ball(25.0).values)
    labels = Volume(ball(17.0).grid, both)
    assert checked(model, labels, 0.3, (2,)).both_mm.mean() < 0.15 * VOXEL_MM
    assert checked(model, labels, 0.3).model_to_labels_mm.mean() == pytest.approx(8.0, abs=0.2)


def test_where_the_image_cuts_the_organ_off_nothing_is_measured(model: DvfModel) -> None:
    whole = ball(20.0)
    middle = slice(14, 27)  # 12 of 40 mm
    grid = Grid.axis_aligned(
        "mr", (whole.grid.shape[0], whole.grid.shape[1], 13), [-30.0, -30.0, -9.0], VOXEL_MM
    )
    found = checked(model, Volume(grid, whole.values[:, :, middle]), 0.0)
    assert found.both_mm.max() < 0.5 * VOXEL_MM
    assert len(found.model_to_labels_mm) < 0.6 * 1500


def test_an_image_that_ends_beside_the_organ_hides_no_error(model: DvfModel) -> None:
    """The labels do not reach the border, so that what the model encloses beyond it is wrong, not cut."""
    found = checked(model, ball(12.0, half_mm=15.0), 0.0)
    assert found.model_to_labels_mm.mean() == pytest.approx(8.0, abs=0.2)
    assert len(found.model_to_labels_mm) == 1500


def test_refusals(model: DvfModel) -> None:
    with pytest.raises(InvalidInputError, match=r"no voxel of the organ labels \[5\].*present are \[0, 1\]"):
        checked(model, ball(20.0), 0.0, (5,))
    far = ball(5.0)
    moved = Volume(Grid.axis_aligned("mr", far.grid.shape, [70.0] * 3, VOXEL_MM), far.values)
    with pytest.raises(InvalidInputError, match="no voxel in common"):
        checked(model, moved, 0.0)
