"""Random fields of the second world: their size, and no rigid part."""

import numpy as np
import pytest

from data_synth.second_world.random_fields import (
    random_displacement_field,
    small_rigid_part,
    solved_inverse,
    wide_noise,
)


def test_a_random_field_has_its_size_and_no_rigid_part() -> None:
    box = np.array([[-50.0, -40.0, -60.0], [50.0, 40.0, 60.0]])
    wide = box + np.array([[-20.0], [20.0]])
    field = random_displacement_field(wide, box, 1.5, 20.0, 4.0, np.random.default_rng(5001))
    places = np.random.default_rng(1).uniform(box[0], box[1], (6000, 3))
    value = field.at(places)
    assert np.sqrt((value**2).sum(axis=1).mean()) == pytest.approx(1.5, rel=0.05)
    shift, turn = small_rigid_part(places, value)
    assert np.abs(shift).max() < 0.05
    assert np.abs(turn).max() < 1e-3
    back = solved_inverse(field, places)
    np.testing.assert_allclose(back + field.at(back), places, atol=1e-3)


def test_noise_drawn_at_few_nodes_keeps_its_size_and_length() -> None:
    noise = wide_noise((60, 80, 50), 1.25, 20.0, np.random.default_rng(5002))
    assert 0.6 < float(np.sqrt((noise**2).mean())) < 1.4
    assert float(np.abs(np.diff(noise, axis=0)).max()) < 0.5
