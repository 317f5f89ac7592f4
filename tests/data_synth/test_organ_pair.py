"""Pairs whose MR is a real cine: what lies between slices, and what the images share."""

import numpy as np
import pytest

from data_synth.organ_pair.cine import QUANTILES, REGIONS, _classes, _fine_grid, heart_labels
from data_synth.organ_pair.pair import cine_pair
from dvf_ig.core import Grid, Volume


def cone() -> Volume:
    """Bright discs whose radius grows by 6 mm a slice, in seven slices of 10 mm."""
    grid = Grid.axis_aligned("moving", (80, 80, 7), [-60.0, -60.0, -30.0], (1.5, 1.5, 10.0))
    p = grid.centers_mm()
    away = np.hypot(p[..., 0], p[..., 1]) - (26.0 + 0.6 * p[..., 2])
    return Volume(grid, 100.0 / (1.0 + np.exp(away / 2.0)))


def test_outlines_not_grey_levels_are_interpolated_between_slices() -> None:
    """Half way between slices the disc's radius is the mean of theirs; of grey levels it would be smaller."""
    mr = cone()
    grid = _fine_grid(mr, np.zeros(3))
    bright = _classes(mr, grid) == len(QUANTILES)
    radius = np.sqrt(bright.sum(axis=(0, 1)) * float(grid.spacing_mm[0]) ** 2 / np.pi)
    z = grid.centers_mm()[0, 0, :, 2]
    low, between, high = np.interp([0.0, 5.0, 10.0], z, radius)
    assert high - low > 4.0
    assert between == pytest.approx((low + high) / 2, abs=0.8)  # a voxel


def test_what_mr_shows_and_ultrasound_does_not_and_the_reverse() -> None:
    organ = heart_labels(cone(), 60.0, 1003)
    classes = len(QUANTILES) + 1
    assert len(organ.acoustics.echo_db) == REGIONS * classes + 3
    assert (organ.labels >= REGIONS * classes).any()
    steps = np.diff(organ.acoustics.impedance[:classes])
    assert (steps == 0.0).any()
    assert (steps > 0.0).any()
    assert (steps < 0.0).any()
    assert abs(float(np.dot(organ.inward, organ.across if organ.across is not None else 1.0))) < 0.2


def test_the_mr_of_a_pair_is_the_image_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("data_synth.organ_pair.cine.VOXEL_MM", 2.0)
    mr = cone()
    pair = cine_pair(mr, 1003)
    assert pair.moving["cine"] is mr
    assert 0.2 < (pair.fixed.values > 0).mean() < 0.5
    assert 0.1 < pair.error_mm(pair.moving_from_fixed) < 2.0
    assert mr.grid.holds(mr.grid.to_index(pair.moving_mm), 0.8).mean() > 0.9
