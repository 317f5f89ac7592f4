"""The simulated device against closed forms of a mass with friction; feed-forward; what both refuse."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import DEVICES, FeedForward, SimulatedDevice
from dvf_ig.guidance.devices.simulated import DeviceState

MASS, VISCOUS = 0.05, 0.8
AXIS = np.array([2.0, -1.0, 2.0]) / 3.0


def run(device, state, force_of, seconds):
    for _ in range(round(seconds * device.rate_hz)):
        state = device.step(state, force_of(state))
    return state


def test_a_constant_force_against_viscous_friction():
    """v = (F/b)(1 − e^(−bt/m)), x = (F/b)(t − v·m/F); first order in the sub-step of 0.1 ms."""
    device = SimulatedDevice("mass", MASS, VISCOUS, 0.0)
    force, t = 0.4 * AXIS, 0.1
    state = run(device, DeviceState.at_rest(np.zeros(3)), lambda _: force, t)
    speed = 1000 * 0.4 / VISCOUS * (1 - math.exp(-VISCOUS * t / MASS))
    way = 1000 * 0.4 / VISCOUS * t - speed * MASS / VISCOUS
    np.testing.assert_allclose(state.velocity_mm_s, speed * AXIS, rtol=1e-3)
    np.testing.assert_allclose(state.position_mm, way * AXIS, rtol=2e-3)


def test_dry_friction_stops_a_mass_after_its_stopping_distance():
    """x = m·v²/(2c), and then it stays exactly where it is."""
    device = SimulatedDevice("mass", MASS, 0.0, 0.2)
    start = DeviceState(np.zeros(3), 200.0 * AXIS)
    state = run(device, start, lambda _: np.zeros(3), 0.2)
    stopping_mm = 1000 * MASS * 0.2**2 / (2 * 0.2)
    np.testing.assert_allclose(state.position_mm, stopping_mm * AXIS, rtol=5e-3)
    assert not state.velocity_mm_s.any()
    again = run(device, state, lambda _: 0.199 * AXIS, 0.05)
    assert np.array_equal(again.position_mm, state.position_mm)
    assert run(device, state, lambda _: 0.21 * AXIS, 0.05).velocity_mm_s @ AXIS > 0


def test_a_spring_makes_it_swing_at_its_frequency():
    """Zero crossings of a mass on 0.1 N/mm: half periods of π√(m/k), sampled at 1 kHz."""
    device = SimulatedDevice("mass", MASS, 0.0, 0.0, rate_hz=10_000.0)
    state, signs = DeviceState(3.0 * AXIS, np.zeros(3)), []
    for _ in range(5000):
        state = device.step(state, -0.1 * state.position_mm)
        signs.append(state.position_mm @ AXIS > 0)
    crossings = np.flatnonzero(np.diff(signs)) / device.rate_hz
    assert np.diff(crossings).mean() == pytest.approx(math.pi * math.sqrt(MASS / 100.0), rel=2e-3)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 3, 10]))
def test_friction_never_adds_energy(seed, steps):
    rng = np.random.default_rng(seed)
    device = SimulatedDevice(
        "any", rng.uniform(0.01, 0.2), rng.uniform(0, 20), rng.uniform(0, 1), steps=steps
    )
    state = DeviceState(np.zeros(3), rng.normal(size=3) * 300)
    for _ in range(20):
        after = device.step(state, np.zeros(3))
        assert np.linalg.norm(after.velocity_mm_s) <= np.linalg.norm(state.velocity_mm_s)
        state = after


def test_forces_are_cut_to_what_the_device_gives_and_faults_to_none():
    weak = SimulatedDevice("weak", MASS, 0.0, 0.0, largest_n=0.5)
    start = DeviceState.at_rest(np.zeros(3))
    strong, full = weak.step(start, 7.0 * AXIS), weak.step(start, 0.5 * AXIS)
    np.testing.assert_allclose(strong.velocity_mm_s, full.velocity_mm_s, rtol=1e-12)
    for broken in (math.nan, math.inf):
        assert not weak.step(start, np.array([broken, 0.0, 0.0])).velocity_mm_s.any()


def test_the_sensor_rounds_to_its_step():
    device = replace(DEVICES["premium"], resolution_mm=0.03)
    xyz = np.array([0.044, -0.046, 1.0])
    np.testing.assert_allclose(device.measured_mm(xyz), [0.03, -0.06, 0.99])
    assert np.array_equal(replace(device, resolution_mm=0.0).measured_mm(xyz), xyz)


def test_feed_forward_pushes_with_the_surface():
    """n = ∇d/|∇d| points into the organ; where d rises at a fixed point the surface comes out, along −n."""
    gradient, rate = np.array([0.0, 0.0, 2.0]), 60.0
    pushed = FeedForward(friction_n=0.2).force(gradient, rate, np.zeros(3))
    np.testing.assert_allclose(pushed, [0, 0, -0.2], atol=1e-9)
    damped = FeedForward(damping_n_s_per_m=2.0).force(gradient, rate, np.array([5.0, 0.0, 10.0]))
    np.testing.assert_allclose(damped, [0, 0, -2.0 * (0.010 - -0.030)])
    along = FeedForward(damping_n_s_per_m=2.0).force(gradient, rate, np.array([0.0, 0.0, -30.0]))
    np.testing.assert_allclose(along, 0.0, atol=1e-15)
    assert not FeedForward(0.5, 0.2).force(np.array([0.0, 0.1, 0.0]), rate, np.ones(3)).any()


@given(st.floats(-200, 200), st.floats(-200, 200))
def test_compensation_gives_no_more_power_than_friction_takes(surface_mm_s, tool_mm_s):
    device = DEVICES["omni"]
    pushed = FeedForward(friction_n=device.dry_n).force(np.array([1.0, 0, 0]), -surface_mm_s, np.zeros(3))
    assert pushed[0] * tool_mm_s <= device.dry_n * abs(tool_mm_s) + 1e-12


def test_what_feed_forward_uses_up_is_missing_from_the_limits():
    device = DEVICES["omni"]
    plain = device.limits(fastest_mm_s=100.0, stiffness_n_per_m=1e6)
    helped = device.limits(fastest_mm_s=100.0, stiffness_n_per_m=1e6, feed_forward=FeedForward(0.1, 0.2))
    span_mm = 100.0 / 1000 + device.resolution_mm
    expected = 2 * (0.26 - 0.2 - (0.1 - 0.005) * 0.1) / span_mm
    assert plain.passive_stiffness_n_per_mm == pytest.approx(2 * (0.26 + 0.005 * 0.1) / span_mm)
    assert helped.passive_stiffness_n_per_mm == pytest.approx(expected)
    with pytest.raises(
        InvalidInputError, match=r"compensates 0\.3 N of friction, but PHANToM Omni has 0\.26 N"
    ):
        device.limits(fastest_mm_s=100.0, feed_forward=FeedForward(friction_n=0.3))


@pytest.mark.parametrize(
    "make",
    [
        lambda: SimulatedDevice("no mass", 0.0, 0.1, 0.1),
        lambda: SimulatedDevice("negative friction", 0.1, 0.1, -0.1),
        lambda: SimulatedDevice("no force", 0.1, 0.1, 0.1, largest_n=0.0),
        lambda: SimulatedDevice("no steps", 0.1, 0.1, 0.1, steps=0),
        lambda: SimulatedDevice("endless", 0.1, math.nan, 0.1),
        lambda: FeedForward(-1.0),
        lambda: FeedForward(slow_mm_s=0.0),
        lambda: DeviceState(np.zeros(2), np.zeros(3)),
    ],
)
def test_senseless_numbers_are_refused(make):
    with pytest.raises(InvalidInputError):
        make()
