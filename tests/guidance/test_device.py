"""What a device renders passively, and the designs that follow from it."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import (
    Confinement,
    DeviceLimits,
    FreeZone,
    Gaussian,
    Sigmoid,
    gaussian_for_free_zone,
    tightest_gaussian,
)

numbers = st.floats(1e-3, 10.0)


@given(numbers, st.floats(0.0, 1.0), st.floats(100.0, 10_000.0))
def test_without_dry_friction_it_is_colgate_and_schenkel_s_bound(b, virtual_share, rate):
    virtual = -virtual_share * b
    limits = DeviceLimits(rate, 1e9, damping_n_s_per_m=b, virtual_damping_n_s_per_m=virtual)
    assert limits.passive_stiffness_n_per_mm == pytest.approx(2 * (b - abs(virtual)) * rate / 1000, abs=1e-12)


@given(numbers, st.floats(1e-3, 1.0), st.floats(1e-3, 0.1))
def test_at_any_speed_it_is_abbott_and_okamura_s_bound(b, c, step):
    limits = DeviceLimits(1000.0, 1e9, b, friction_n=c, resolution_mm=step)
    assert limits.passive_stiffness_n_per_mm == pytest.approx(min(2 * b, 2 * c / step))


@given(numbers, st.floats(1e-3, 1.0), st.floats(1e-3, 0.1), st.floats(1.0, 500.0))
def test_up_to_a_speed_no_sample_gives_more_energy_than_friction_takes(b, c, step, fastest):
    """½Kx² + ½KΔx <= b·x²/T + c·x for every x = vT, and at the bound with equality for one of them."""
    limits = DeviceLimits(1000.0, 1e9, b, friction_n=c, resolution_mm=step, fastest_mm_s=fastest)
    k = limits.passive_stiffness_n_per_mm
    x = np.linspace(1e-9, 1.0, 2001) * fastest / 1000.0
    given_mj = 0.5 * k * x * (x + step)
    taken_mj = b / 1000 * x**2 * 1000 + c * x
    assert (given_mj <= taken_mj * (1 + 1e-9)).all()
    assert (taken_mj / given_mj).min() == pytest.approx(1.0, rel=2e-3)


def test_refusals_give_the_numbers():
    limits = DeviceLimits(damping_n_s_per_m=0.1, virtual_damping_n_s_per_m=0.02)
    with pytest.raises(
        InvalidInputError,
        match=r"300 N/m at its steepest, at most 160 N/m allowed by passivity at 1000 Hz "
        r"\(b 0\.1, \|B\| 0\.02 N·s/m\); use gamma_per_mm <= 1\.067",
    ):
        limits.checked(Sigmoid(2.0))
    with pytest.raises(InvalidInputError, match=r"405 N/m .* 400 N/m allowed by its stiffness cap"):
        DeviceLimits().checked(Confinement(2.7))
    slow = DeviceLimits(damping_n_s_per_m=0.0, friction_n=0.02, resolution_mm=0.1, fastest_mm_s=100.0)
    with pytest.raises(InvalidInputError, match=r"dry friction 0\.02 N up to 100 mm/s, resolution 0\.1 mm"):
        slow.checked(Sigmoid(2.0))
    for name in ("damping_n_s_per_m", "friction_n", "resolution_mm"):
        with pytest.raises(InvalidInputError, match=name):
            DeviceLimits(**{name: -0.1})
    with pytest.raises(InvalidInputError, match="fastest_mm_s"):
        DeviceLimits(fastest_mm_s=0.0)


def test_a_free_zone_is_the_flattest_that_the_device_renders():
    wide = gaussian_for_free_zone(FreeZone(3.0, 0.03))
    narrow = gaussian_for_free_zone(FreeZone(0.3, 0.03))
    for law, width in ((wide, 3.0), (narrow, 0.3)):
        assert 0.6 * law.potential(np.array([width]))[0] == pytest.approx(0.03)
        assert law.stiffness_n_per_mm <= 0.4
    assert wide.m > narrow.m
    with pytest.raises(
        InvalidInputError, match=r"±0\.01 mm .* 400 N/m; the narrowest it renders is ±0\.0769 mm"
    ):
        gaussian_for_free_zone(FreeZone(0.01, 0.03))
    with pytest.raises(InvalidInputError, match="between 0 and the cap"):
        gaussian_for_free_zone(FreeZone(1.0, 0.7))


@given(st.floats(0.005, 0.55), st.floats(50.0, 2000.0))
def test_the_tightest_law_has_the_narrowest_dead_band(friction, stiffness):
    device = DeviceLimits(stiffness_n_per_m=stiffness)
    law = tightest_gaussian(friction, device=device)
    device.checked(law)
    assert 0.6 * law.potential(np.array([law.half_width_mm(friction)]))[0] == pytest.approx(friction)
    for m in (0.5, 1.0, 2.0, 4.0):
        unit = Gaussian(1.0, m)
        other = Gaussian(unit.stiffness_n_per_mm / (stiffness / 1000), m)
        assert law.half_width_mm(friction) <= other.half_width_mm(friction) * (1 + 1e-6)


def test_little_friction_asks_for_the_exponential_law():
    """Theory: m = 1/2 alone is stiffest at its target; its dead band is about f/K."""
    law = tightest_gaussian(0.01)
    assert law.m == 0.5
    assert law.half_width_mm(0.01) == pytest.approx(0.01 / 0.4, rel=0.02)


@given(st.floats(0.05, 0.95), st.sampled_from([0.5, 1.0, 2.0]))
def test_half_width_inverts_the_law(share, m):
    law = Gaussian(2.0, m)
    assume(0.0 < share * law.cap_n < law.cap_n)
    s = law.half_width_mm(share * law.cap_n)
    assert law.potential(np.array([s]))[0] == pytest.approx(share)


def test_a_device_that_renders_nothing_is_named():
    dead = DeviceLimits(damping_n_s_per_m=0.1, virtual_damping_n_s_per_m=0.2)
    assert dead.passive_stiffness_n_per_mm == 0.0
    with pytest.raises(InvalidInputError, match="renders no stiffness"):
        tightest_gaussian(0.1, device=dead)
    assert math.isinf(DeviceLimits().passive_stiffness_n_per_mm)
