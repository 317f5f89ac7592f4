"""A motion that does not return when registered back is found and estimated anew with less freedom."""

from dataclasses import replace

import numpy as np
import pytest
from short_axis_toy import contracting_stack

from dvf_ig.core import VolumeSeries
from dvf_ig.preop import track_cycle
from dvf_ig.preop.motion import cycle
from dvf_ig.preop.motion.consistency import (
    LIMIT_MM,
    STIFFER,
    inconsistency_mm,
    inverse_index,
    made_consistent,
    parts_of,
)
from dvf_ig.preop.motion.free_form import FreeForm, Lattice
from dvf_ig.preop.motion.image_match import FreeFormOptions, match_images

OBSERVABLE = np.array([True, True, False])


@pytest.fixture(scope="module")
def pair():
    image, labels = contracting_stack((1.0, 0.8))
    lattice = Lattice.over(image.grid, np.array([6.0, 6.0, 10.0]))
    return (image.values[0], image.values[1]), labels[0], lattice


def test_a_motion_that_the_images_show_returns_and_is_left_alone(pair):
    images, labels, lattice = pair
    mask = np.ones(labels.shape, dtype=np.bool_)
    parts = parts_of(labels > 0, labels == 2)
    assert len(parts) == 2
    forward = match_images(images[0], images[1], mask, FreeForm.identity(lattice), observable=OBSERVABLE)
    kept, off_mm = made_consistent(forward, images, mask, parts, OBSERVABLE, FreeFormOptions())
    assert off_mm < 1.0
    assert kept is forward


def test_a_motion_that_the_images_do_not_show_is_made_stiffer(pair):
    """Knots moved at random by 9 mm, standard deviation, from what the images show."""
    images, labels, lattice = pair
    mask = np.ones(labels.shape, dtype=np.bool_)
    parts, options = parts_of(labels > 0, None), FreeFormOptions()
    wild = FreeForm(lattice, np.random.default_rng(1).normal(0.0, 9.0, (*lattice.shape, 3)) * OBSERVABLE)
    kept, off_mm = made_consistent(wild, images, mask, parts, OBSERVABLE, options)
    assert off_mm > LIMIT_MM
    stiffer = replace(options, stiffness_mm2=STIFFER * options.stiffness_mm2)
    expected = match_images(images[0], images[1], mask, wild, stiffer, observable=OBSERVABLE)
    np.testing.assert_array_equal(kept.coefficients, expected.coefficients)
    assert inconsistency_mm(kept, images, mask, parts, OBSERVABLE, options) < off_mm


def test_the_inverse_undoes_the_motion():
    """Of a stretch by a tenth about the corner, in closed form."""
    here = np.indices((12, 11, 6), dtype=np.float64)
    np.testing.assert_allclose(inverse_index(0.1 * here)[:, :8], (here / 1.1)[:, :8], atol=1e-6)


def test_the_phase_is_named(monkeypatch):
    image, labels = contracting_stack((1.0, 0.9, 0.95))

    def unsure(forward, *_):
        return forward, LIMIT_MM + 1.0

    assert track_cycle(image, labels[0] > 0).stiffened == ()
    monkeypatch.setattr(cycle, "made_consistent", unsure)
    motion = track_cycle(VolumeSeries(image.grid, image.values, image.timing), labels[0] > 0)
    assert [s.phase for s in motion.stiffened] == [1, 2]
