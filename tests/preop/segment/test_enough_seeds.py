"""Seeds that are too few are told by what grew from them, with the slices that need more."""

import numpy as np
from short_axis_toy import contracting_stack

from dvf_ig.core import Points, Seeds, Volume, VolumeSeries
from dvf_ig.preop import dice, seed_shortage, segment_from_seeds

CENTER_MM = 0.5 * 1.5 * 43


def seeds_on(image, slices, around=range(8)):
    """One in the blood, four in the wall and eight around it (or these of them), in each of these slices."""
    ring = np.array([[np.cos(a), np.sin(a)] for a in np.arange(8) * np.pi / 4])

    def at(radius_mm, directions):
        return [[*(CENTER_MM + radius_mm * d), 10.0 * k] for k in slices for d in directions]

    wall_mm = 18.0
    return Seeds(
        Points("mr", np.array(at(wall_mm, ring[::2]))),
        Points("mr", np.array(at(27.0, ring[list(around)]))),
        Points("mr", np.array(at(0.0, ring[:1]))),
    )


def test_seeds_on_one_slice_are_too_few_and_the_next_slices_are_named():
    image, labels = contracting_stack((1.0, 0.9))
    seeds = seeds_on(image, [2])
    found = segment_from_seeds(image.phase(0), seeds)
    assert dice(found.values > 0, labels[0] > 0) < 0.75
    shortage = seed_shortage(image.phase(0), found, seeds)
    assert shortage.unseeded == (0, 4)
    assert shortage.more == ((0, "4 heart, 2 cavity, 6 background"), (4, "4 heart, 2 cavity, 6 background"))
    assert "before slice 0 and 4" in shortage.told[0]
    assert "across axis k): slice 0: 4 heart, 2 cavity, 6 background; slice 4" in shortage.told[-1]


def test_seeds_on_every_slice_are_enough():
    image, labels = contracting_stack((1.0, 0.9))
    seeds = seeds_on(image, range(5))
    found = segment_from_seeds(image.phase(0), seeds)
    assert dice(found.values > 0, labels[0] > 0) > 0.85
    assert seed_shortage(image.phase(0), found, seeds).told == ()


def test_an_outline_around_the_blood_is_told():
    image, labels = contracting_stack((1.0, 0.9))
    seeds = seeds_on(image, range(5))
    blood = image.phase(0)
    bare = type(blood)(blood.grid, np.where(labels[0] == 2, 2, 0).astype(np.uint8))
    shortage = seed_shortage(image.phase(0), bare, seeds)
    assert shortage.without_wall == (0, 1, 2, 3, 4)
    assert "around the blood" in shortage.told[0]


def test_a_second_ventricle_without_seeds_is_told_with_its_slices():
    """Blood of the same brightness beside the heart, in slices 1 to 3, that no seed names."""
    image, labels = contracting_stack((1.0, 0.9))
    values = image.values.copy()
    x, y = np.meshgrid(*(1.5 * np.arange(44),) * 2, indexing="ij")
    values[0, np.hypot(x - 62.0, y - CENTER_MM) < 11.0, 1:4] = 1.0
    beside = VolumeSeries(image.grid, values, image.timing)
    ring = [k for k in range(8) if k not in (7, 0, 1)]
    seeds = seeds_on(image, range(5), ring)
    bare = Volume(image.grid, labels[0])
    shortage = seed_shortage(beside.phase(0), bare, seeds)
    assert shortage.blood_left_out == (1, 2, 3)
    assert "blood lies next to the outline" in " ".join(shortage.told)


def test_an_outline_that_hangs_on_single_seeds_is_told():
    """Background seeds on one side alone, in noise: which of them are left out decides the rest."""
    image, labels = contracting_stack((1.0, 0.9), noise=0.4)
    few = seeds_on(image, [0, 2, 4], [0, 3])
    found = segment_from_seeds(image.phase(0), few)
    assert dice(found.values > 0, labels[0] > 0) < 0.85
    assert seed_shortage(image.phase(0), found, few).unstable
