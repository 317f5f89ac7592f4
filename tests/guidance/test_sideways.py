"""Stiffness beside a law's own slope: curved surfaces, and places between two walls."""

from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import DeviceLimits, Evaluator, Fixtures, FixtureSet, Sigmoid
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.servo import Servo
from dvf_ig.guidance.sideways import check_sideways, sideways_stiffness
from dvf_ig.study.passivity import HALF_MM, KNOT_MM, wall_model


def slab(half_mm):
    """An organ between two walls: d = h − |x|, whose medial axis is a plane."""
    model = wall_model()
    place = KNOT_MM * (np.arange(model.coefficients.shape[1]) - 1.0) - HALF_MM
    field = (half_mm - np.abs(place))[None, :, None, None]
    return replace(model, coefficients=np.broadcast_to(field, model.coefficients.shape).astype(np.float32))


def test_beside_a_ball_it_is_force_over_radius(ball):
    """Sideways stiffness F·κ: 5 mm inside a ball of 13 to 16 mm, 0.6 N over 8 mm."""
    worst = sideways_stiffness(Evaluator(ball, Sigmoid(2.0, 0.6)), DeviceLimits())
    assert worst is not None
    radius = 13.0 - worst.distance_mm
    assert worst.n_per_mm == pytest.approx(0.6 / radius, rel=0.1)
    assert worst.share_beyond == 0.0


def test_a_flat_wall_has_none():
    worst = sideways_stiffness(Evaluator(wall_model(), Sigmoid()), DeviceLimits())
    assert worst is not None
    assert worst.n_per_mm < 1e-5


def test_a_thin_organ_is_refused_with_the_numbers():
    """Between walls 8 mm apart the force of 0.6 N turns round over one knot."""
    thin = Evaluator(slab(4.0), Sigmoid())
    limits = DeviceLimits(stiffness_n_per_m=200.0)
    with pytest.raises(InvalidInputError, match=r"turns too fast .* 200 N/m at .*%"):
        check_sideways(thin, limits)
    check_sideways(Evaluator(slab(20.0), Sigmoid()), limits)


def test_a_servo_asks(ball):
    limits = DeviceLimits(stiffness_n_per_m=40.0)
    device = RecordedDevice(np.zeros((1, 3)), 1000.0)
    with pytest.raises(InvalidInputError, match="turns too fast"):
        Servo(Fixtures(ball, FixtureSet()), device, limits=limits)
