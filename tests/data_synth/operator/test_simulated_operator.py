"""The loop that vision closes against its closed form; what is felt; what differs between operators."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest

from data_synth.operator.held_instrument import HandDynamics, HeldInstrument, Stylus
from data_synth.operator.operator_spec import OperatorSpec, drawn_operator
from data_synth.operator.simulated_operator import RATE_HZ, LearntForce, SimulatedOperator
from dvf_ig.core import FloatArray, InvalidInputError

SIGHT = np.array([0.0, 0.0, 1.0])
QUIET = OperatorSpec(
    hand=HandDynamics(0.01, 3.0, 1000.0), depth_noise_mm=0.0, sideways_noise_mm=0.0, tremor_rms_mm=0.0
)
"""A light and stiff hand that sees exactly: what is left is delay and crossover."""
CALL = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p)


def follow(
    spec: OperatorSpec,
    aim_mm: FloatArray,
    *,
    seed: int = 1,
    force_n: FloatArray | None = None,
    learnt: LearntForce | None = None,
    seconds: float = 3.0,
) -> FloatArray:
    """(n, 3) tip at every step while the operator aims at one point from the origin, under a force."""
    instrument = HeldInstrument(np.zeros(3), spec.hand, Stylus(0.01, 0.0, 0.0))
    operator = SimulatedOperator(spec, seed, instrument, SIGHT, learnt)
    read, write = (CALL(int(address)) for address in instrument.functions)
    tips, out = [], np.zeros(3)
    force = np.zeros(3) if force_n is None else force_n.copy()
    for k in range(round(seconds * RATE_HZ)):
        tips.append(instrument.tip_mm)
        operator.step(aim_mm, np.zeros(3))
        for tick in range(1000 // RATE_HZ):
            now_ns = 1_000_000_000 + (k * 1000 // RATE_HZ + tick) * 1_000_000
            read(instrument.context.ctypes.data, now_ns, out.ctypes.data)
            write(instrument.context.ctypes.data, now_ns, force.ctypes.data)
    return np.array(tips)


def crossover_step(t_s: FloatArray, crossover: float, delay_s: float) -> FloatArray:
    """x(t) of ẋ = ω_c (aim − x)(t − τ) from rest, the aim being 1 from t = 0 on: 1 − Σ (−ω_c(t − kτ))ᵏ/k!."""
    out, factorial = np.ones_like(t_s), 1.0
    for k in range(40):
        factorial *= max(k, 1)
        out -= np.where(t_s >= k * delay_s, (-crossover * (t_s - k * delay_s)) ** k / factorial, 0.0)
    return out


def test_a_step_of_the_aim_is_answered_as_the_crossover_model_says() -> None:
    x = follow(QUIET, np.array([1.0, 0.0, 0.0]))[:, 0]
    t = np.arange(len(x)) / RATE_HZ
    assert np.abs(x[t <= 0.2]).max() < 1e-9, "nothing before the delay"
    np.testing.assert_allclose(x, crossover_step(t, 3.5, 0.2), atol=0.05)


@pytest.mark.parametrize(("crossover", "grows"), [(1.45 / 0.2, False), (1.75 / 0.2, True)])
def test_the_loop_is_stable_up_to_a_quarter_turn(crossover: float, grows: bool) -> None:
    """ω_c τ < π/2."""
    spec = replace(QUIET, crossover_rad_s=crossover)
    error = np.abs(1.0 - follow(spec, np.array([1.0, 0.0, 0.0]), seconds=8.0)[:, 0])
    assert (error[-200:].max() > error[200:400].max()) == grows


def test_depth_is_seen_worse_than_what_lies_across() -> None:
    spec = replace(QUIET, depth_noise_mm=0.8, sideways_noise_mm=0.2)
    spread = np.mean([follow(spec, np.zeros(3), seed=s, seconds=12.0).std(axis=0) for s in range(3)], axis=0)
    assert 0.5 < spread[2] < 1.6
    np.testing.assert_allclose(spread[2] / spread[:2], 4.0, rtol=0.5)
    twice = replace(spec, depth_noise_mm=1.6)
    once_z, twice_z = (follow(s, np.zeros(3), seed=3, seconds=2.0)[:, 2] for s in (spec, twice))
    np.testing.assert_allclose(twice_z, 2.0 * once_z, atol=1e-6)


def test_vision_alone_overcomes_a_steady_force_and_what_is_felt_holds_back() -> None:
    """The force says: 2 mm too deep along it. Seen, the tip is where it should be."""
    pushed = np.array([0.0, 0.0, 0.3])
    learnt = LearntForce(np.array([0.1, 0.3, 0.5]), np.array([1.0, 2.0, 3.0]))
    spec = replace(QUIET, depth_noise_mm=0.8, noise_hz=(1e-6, 2e-6))
    deaf = replace(spec, attends=False)
    seeds = range(3)
    blind_z = [follow(deaf, np.zeros(3), seed=s, force_n=pushed, learnt=learnt)[-1, 2] for s in seeds]
    free_z = [follow(deaf, np.zeros(3), seed=s)[-1, 2] for s in seeds]
    np.testing.assert_allclose(blind_z, free_z, atol=0.02)
    felt_z = [
        follow(spec, np.zeros(3), seed=s, force_n=pushed, learnt=learnt, seconds=1.5)[-1, 2] for s in seeds
    ]
    assert min(felt_z) > 1.0, "moves along the force, which keeps saying so"


def test_a_learnt_force_is_read_between_its_ends_and_refuses_what_has_no_order() -> None:
    learnt = LearntForce(np.array([0.1, 0.3, 0.5]), np.array([-1.0, 0.0, 2.0]))
    assert learnt.read(0.2) == pytest.approx((-0.5, 5.0))
    assert learnt.read(0.4) == pytest.approx((1.0, 10.0))
    assert learnt.read(9.0) == pytest.approx((2.0, 10.0))
    with pytest.raises(InvalidInputError, match="increasing"):
        LearntForce(np.array([0.1, 0.1]), np.array([0.0, 1.0]))


def test_an_operator_is_the_same_whatever_the_task_and_operators_differ() -> None:
    mean = OperatorSpec()
    one, again, other = (drawn_operator(seed, mean) for seed in (7, 7, 8))
    assert one == again
    assert one.visual_delay_s != other.visual_delay_s
    doubled = drawn_operator(7, replace(mean, depth_noise_mm=1.6))
    assert doubled.depth_noise_mm == pytest.approx(2.0 * one.depth_noise_mm)
    assert replace(doubled, depth_noise_mm=one.depth_noise_mm) == one
    delays = np.log([drawn_operator(s, mean).visual_delay_s / 0.2 for s in range(400)])
    assert delays.std() == pytest.approx(0.15, rel=0.15)
    with pytest.raises(InvalidInputError, match="depth_noise_mm"):
        OperatorSpec(depth_noise_mm=-1.0)
