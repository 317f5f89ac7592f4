"""Seeds that are too few are told by what grew from them, with the slices that need more."""

import numpy as np
from short_axis_toy import contracting_stack

from dvf_ig.core import Points, Seeds
from dvf_ig.preop import dice, seed_shortage, segment_from_seeds

CENTER_MM = 0.5 * 1.5 * 43


def seeds_on(image, slices):
    """One in the blood, four in the wall and eight around it, in each of these slices."""
    ring = np.array([[np.cos(a), np.sin(a)] for a in np.arange(8) * np.pi / 4])

    def at(radius_mm, directions):
        return [[*(CENTER_MM + radius_mm * d), 10.0 * k] for k in slices for d in directions]

    wall_mm = 18.0
    return Seeds(
        Points("mr", np.array(at(wall_mm, ring[::2]))),
        Points("mr", np.array(at(27.0, ring))),
        Points("mr", np.array(at(0.0, ring[:1]))),
    )


def test_seeds_on_one_slice_are_too_few_and_the_next_slices_are_named():
    image, labels = contracting_stack((1.0, 0.9))
    seeds = seeds_on(image, [2])
    found = segment_from_seeds(image.phase(0), seeds)
    assert dice(found.values > 0, labels[0] > 0) < 0.75
    shortage = seed_shortage(found, seeds)
    assert shortage.unseeded == (0, 4)
    assert "slice 0 and 4 across axis k" in shortage.told[0]


def test_seeds_on_every_slice_are_enough():
    image, labels = contracting_stack((1.0, 0.9))
    seeds = seeds_on(image, range(5))
    found = segment_from_seeds(image.phase(0), seeds)
    assert dice(found.values > 0, labels[0] > 0) > 0.85
    assert seed_shortage(found, seeds).told == ()


def test_an_outline_around_the_blood_is_told():
    image, labels = contracting_stack((1.0, 0.9))
    seeds = seeds_on(image, range(5))
    blood = image.phase(0)
    bare = type(blood)(blood.grid, np.where(labels[0] == 2, 2, 0).astype(np.uint8))
    shortage = seed_shortage(bare, seeds)
    assert shortage.without_wall == (0, 1, 2, 3, 4)
    assert "heart seeds" in shortage.told[0]
