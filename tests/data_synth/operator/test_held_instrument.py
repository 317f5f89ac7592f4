"""Hand, device and fulcrum: closed-form step response, lever and inversion, power, friction."""

import ctypes

import numpy as np
import pytest

from data_synth.kernels.held_instrument import CONTEXT_SIZE, FORCE_N
from data_synth.operator.fulcrum import Fulcrum
from data_synth.operator.hand import TREMOR_RMS_MM
from data_synth.operator.held_instrument import HandDynamics, HeldInstrument, Stylus
from data_synth.operator.operator_spec import OperatorSpec
from data_synth.operator.simulated_operator import RATE_HZ, SimulatedOperator
from dvf_ig.core import FloatArray, InvalidInputError

FREE = Stylus(mass_kg=0.072, viscous_n_s_per_m=0.0, dry_n=0.0)
LEVER = Fulcrum(np.zeros(3), 300.0)
CALL = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p)


def call(instrument: HeldInstrument, which: int, now_s: float, numbers: FloatArray) -> None:
    """Read (0) or write (1) as a servo does."""
    function = CALL(int(instrument.functions[which]))
    now_ns = round(1e9 * (1.0 + now_s))
    assert function(instrument.context.ctypes.data, now_ns, numbers.ctypes.data) == 0


def moved(instrument: HeldInstrument, t_s: FloatArray, force_n: FloatArray | None = None) -> FloatArray:
    """Measured tip (n, 3) at times from 0 on, 1 ms apart, under a force at the tip that is sent each time."""
    out = np.empty((len(t_s), 3))
    for i, t in enumerate(t_s.tolist()):
        call(instrument, 0, t, out[i])
        call(instrument, 1, t, np.zeros(3) if force_n is None else force_n.copy())
    return out


def test_step_of_the_hand_is_that_of_a_damped_oscillator() -> None:
    hand = HandDynamics()
    instrument = HeldInstrument(np.zeros(3), hand, FREE)
    instrument.command(np.array([1.0, 0.0, 0.0]), np.zeros(3))
    t = np.arange(500) / 1000.0
    x = moved(instrument, t)[:, 0]
    mass = hand.mass_kg + FREE.mass_kg
    turn = np.sqrt(hand.stiffness_n_per_m / mass)
    ratio = hand.damping_n_s_per_m / (2.0 * mass * turn)
    swing = turn * np.sqrt(1.0 - ratio**2)
    ideal = np.cos(swing * t) + ratio / np.sqrt(1 - ratio**2) * np.sin(swing * t)
    np.testing.assert_allclose(x, 1.0 - np.exp(-ratio * turn * t) * ideal, atol=2e-3)
    assert x.max() == pytest.approx(1.0 + np.exp(-np.pi * ratio / np.sqrt(1 - ratio**2)), abs=2e-3)


def test_a_force_moves_the_hand_by_force_over_stiffness_after_its_delay() -> None:
    late = Stylus(0.072, 0.0, 0.0, delay_s=0.02)
    instrument = HeldInstrument(np.zeros(3), HandDynamics(), late)
    x = moved(instrument, np.arange(2000) / 1000.0, np.array([0.0, 0.3, 0.0]))[:, 1]
    assert np.abs(x[:20]).max() == 0.0
    assert x[20:25].max() > 0.0
    assert x[-1] == pytest.approx(3.0, abs=1e-3), "0.3 N over 100 N/m"


def test_dry_friction_holds_a_hand_at_rest_and_a_motor_has_a_limit() -> None:
    rough = Stylus(0.072, 0.0, 0.05, largest_n=0.2)
    t = np.arange(3000) / 1000.0
    still = HeldInstrument(np.zeros(3), HandDynamics(), rough)
    assert np.abs(moved(still, t, np.array([0.049, 0.0, 0.0]))).max() == 0.0
    pushed = HeldInstrument(np.zeros(3), HandDynamics(), rough)
    # 0.2 of 1 N reach the hand; friction holds it where spring and motor differ by up to 0.05 N
    assert moved(pushed, t, np.array([1.0, 0.0, 0.0]))[-1, 0] == pytest.approx(2.0, abs=0.501)


def test_a_fulcrum_inverts_and_scales_what_goes_sideways_alone() -> None:
    tip = np.array([0.0, 0.0, -100.0])
    np.testing.assert_allclose(LEVER.hand(tip), [0.0, 0.0, 200.0])
    assert LEVER.lever(tip) == pytest.approx(0.5)
    np.testing.assert_allclose(LEVER.tip(LEVER.hand(np.array([7.0, -4.0, -90.0]))), [7.0, -4.0, -90.0])


def test_power_is_the_same_on_both_sides() -> None:
    tip = np.array([20.0, -10.0, -95.0])
    hand, h = LEVER.hand(tip), 1e-5
    steps = [LEVER.tip(hand + h * e) - LEVER.tip(hand - h * e) for e in np.eye(3)]
    jacobian = np.array(steps).T / (2 * h)
    instrument = HeldInstrument(tip, HandDynamics(), FREE, fulcrum=LEVER)
    force = np.array([0.2, 0.1, -0.3])
    moved(instrument, np.array([0.0, 0.001, 0.002]), force)
    felt = instrument.felt_n
    np.testing.assert_allclose(felt, jacobian.T @ force, atol=1e-5)
    speed = np.array([3.0, -8.0, 2.0])
    assert felt @ speed == pytest.approx(force @ (jacobian @ speed), rel=1e-3)


def test_sideways_force_pushes_a_hand_the_other_way_by_the_lever() -> None:
    tip = np.array([0.0, 0.0, -100.0])
    instrument = HeldInstrument(tip, HandDynamics(), FREE, fulcrum=LEVER)
    last = moved(instrument, np.arange(2000) / 1000.0, np.array([0.1, 0.0, 0.0]))[-1]
    # −0.05 N at the hand move it −0.5 mm, and the tip +0.25 mm
    assert instrument.hand_mm[0] == pytest.approx(-0.5, abs=0.01)
    assert last[0] == pytest.approx(0.25, abs=0.01)


def test_a_hand_that_is_let_go_loses_energy_all_the_time() -> None:
    hand = HandDynamics()
    instrument = HeldInstrument(np.array([3.0, -2.0, 1.0]), hand, Stylus(0.072, 0.005, 0.038))
    instrument.command(np.zeros(3), np.zeros(3))
    energy, out = [], np.empty(3)
    for k in range(600):
        call(instrument, 0, k / 1000.0, out)
        x, v = instrument.hand_mm, instrument.hand_mm_s
        energy.append(0.5 * hand.stiffness_n_per_m * x @ x + 0.5 * instrument.mass_kg * v @ v)
    # per sub-step the explicit spring may lend ½K(hv)²: 1 part in 10⁴ here
    assert (np.diff(energy) <= 1e-4 * energy[0]).all()
    assert energy[-1] < 0.05 * energy[0]


def test_a_delay_beyond_the_queue_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="delay"):
        HeldInstrument(np.zeros(3), HandDynamics(), Stylus(0.07, 0.0, 0.0, delay_s=0.2))
    with pytest.raises(InvalidInputError, match="long"):
        Fulcrum(np.zeros(3), 0.0)
    assert FORCE_N < CONTEXT_SIZE


def test_tremor_of_a_free_hand_is_what_was_asked_for() -> None:
    spec = OperatorSpec(depth_noise_mm=0.0, sideways_noise_mm=0.0, crossover_rad_s=0.0)
    instrument = HeldInstrument(np.zeros(3), spec.hand, FREE)
    operator = SimulatedOperator(spec, 5, instrument, np.array([0.0, 0.0, 1.0]))
    tip, out = [], np.empty(3)
    for k in range(2000):
        if k % (1000 // RATE_HZ) == 0:
            operator.step(np.zeros(3), np.zeros(3))
        call(instrument, 0, k / 1000.0, out)
        tip.append(out.copy())
    moved_mm = np.array(tip)[500:]
    assert np.sqrt((moved_mm**2).sum(axis=1).mean()) == pytest.approx(TREMOR_RMS_MM, rel=0.3)
