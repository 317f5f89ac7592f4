"""A cone in slices 10 mm apart: between them its outline is interpolated by depth."""

import numpy as np
import pytest

from dvf_ig.core import Grid, Mesh
from dvf_ig.preop.surface.between_slices import between_slices
from dvf_ig.preop.surface.from_labels import surface_of_mask

GRID = Grid.axis_aligned("mr", (60, 60, 7), [-45.0, -45.0, 0.0], [1.5, 1.5, 10.0])
APEX_MM, TIP_MM, SLOPE = 8.0, 14.0, 0.45


def radius_mm(z_mm: np.ndarray) -> np.ndarray:
    return TIP_MM + SLOPE * (z_mm - APEX_MM)


def cone() -> np.ndarray:
    """It begins between slices 0 and 1, and leaves the image beyond the last."""
    at = GRID.centers_mm()
    inside = np.hypot(at[..., 0], at[..., 1]) < radius_mm(at[..., 2])
    return np.asarray(inside & (at[..., 2] > APEX_MM))


def errors_mm(mesh: Mesh) -> np.ndarray:
    """Distances of the vertices between the first and the last slice from the cone's side."""
    at = mesh.vertices_mm
    between = (at[:, 2] > 12.0) & (at[:, 2] < 58.0)
    side = np.hypot(at[between, 0], at[between, 1]) - radius_mm(at[between, 2])
    return np.asarray(side / np.hypot(1.0, SLOPE))


def test_the_side_follows_a_cone_between_slices() -> None:
    mask, grid = between_slices(cone(), GRID)
    # pixels of 1.5 mm leave 0.4 mm
    assert np.sqrt((errors_mm(surface_of_mask(mask, grid)) ** 2).mean()) < 0.45
    # half-way between two slices the outline lies half-way, where the mask of either is off by 2.25 mm
    z_mm = grid.to_mm(np.column_stack([np.zeros((grid.shape[2], 2)), np.arange(grid.shape[2])]))[:, 2]
    k = int(np.argmin(np.abs(z_mm - 35.0)))
    found = np.sqrt(mask[:, :, k].sum() * 1.5**2 / np.pi)
    assert found == pytest.approx(radius_mm(np.array(35.0)), abs=0.5)


def test_ends_close_within_the_image_and_stay_open_at_its_border() -> None:
    mask, grid = between_slices(cone(), GRID)
    height = grid.to_mm(
        np.stack([np.zeros(grid.shape[2]), np.zeros(grid.shape[2]), np.arange(grid.shape[2])], 1)
    )
    z_mm = height[:, 2]
    area = mask.sum(axis=(0, 1))
    assert z_mm[0] == pytest.approx(5.0)
    assert z_mm[-1] == pytest.approx(65.0)
    assert area[0] == 0
    assert (np.diff(area[z_mm <= 10.0]) >= 0).all()
    assert area[-1] == area[z_mm >= 60.0].max() > 0, "the image ends there, not the cone"
    same = mask[:, :, int(np.argmin(np.abs(z_mm - 30.0)))] == cone()[:, :, 3]
    assert same.mean() > 0.99
