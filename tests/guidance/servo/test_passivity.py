"""Sampling makes energy: what it does, and that the controller takes it back."""

import numpy as np
import pytest

from dvf_ig.core import Rigid
from dvf_ig.guidance import (
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    Hazard,
    PathTarget,
    Sigmoid,
    SupervisorState,
)
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.devices.simulated import PREMIUM, Hand
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, SimulatedServo
from dvf_ig.study.passivity import (
    CAP_N,
    STEEP,
    UNBOUNDED_MJ,
    VISCOUS,
    beating_walls,
    lines_before_walls,
    on_the_wall,
    passive_gamma,
    press,
    steady_transform,
    steep_walls,
    wall_model,
)

PUSH = Hand(push_n=np.array([0.3, 0.0, 0.0]))


def pushed(steepness, options, device=VISCOUS, seconds=6.0, hand=PUSH, **more):
    wall = on_the_wall(Sigmoid(steepness * passive_gamma(device), CAP_N))
    return press(wall_model(), wall, device, hand, seconds=seconds, start_mm=-1.0, options=options, **more)


def test_the_passive_gamma_is_the_theory_s():
    """γ ≤ 8b/(F·T): 0.1 N·s/m, 0.6 N, 1 ms."""
    assert passive_gamma(VISCOUS) == pytest.approx(8 * 0.1e-3 / (0.6 * 1e-3))


def test_a_wall_three_times_too_steep_oscillates_without_the_controller_and_rests_with_it():
    for case in steep_walls(20.0):
        assert case.without_mm > 0.3
        assert case.with_mm < 0.01
        assert case.limit_reached_s < 10.0
        assert case.largest_residual_mj < 0.5


def test_between_a_guided_line_and_a_wall_nothing_oscillates():
    """Both as stiff as each device allows, in a hand that damps nothing, the line at rest and beating."""
    for case in lines_before_walls():
        assert case.with_mm < 0.01
        assert case.largest_n <= CAP_N
        assert case.largest_residual_mj < 1.0
        assert case.state == "OK"


def test_energy_beyond_the_limit_withdraws_the_force_and_latches():
    options = ServoOptions(largest_damping_n_s_per_m=0.0, predict_tool=False)
    run = pushed(STEEP, options, seconds=8.0).record
    first = int(np.flatnonzero(run.hazards & Hazard.ENERGY)[0])
    assert 5.0 < run.residual_mj[first] < 5.1
    assert run.state[first + 251] == SupervisorState.LATCHED
    assert not run.sent_n[first + 251 :].any()


def test_a_wall_within_the_limit_needs_no_controller():
    """At half of the passive γ the energy made stays far below what the device dissipates."""
    options = ServoOptions(largest_damping_n_s_per_m=0.0, predict_tool=False)
    run = pushed(0.5, options, seconds=30.0)
    assert run.rms_mm < 1e-3
    assert run.record.state[-1] == SupervisorState.OK


def test_the_residual_of_one_step_is_half_the_stiffness_times_the_step_squared():
    """r = ½K·Δx²: a spring K moved by Δx between two ticks, its force held meanwhile."""
    gamma, cap = 0.23, 0.6
    stiffness = gamma * cap / 4
    hand = Hand(place_mm=np.array([168.0, 0.0, 0.0]), stiffness_n_per_m=2.0, damping_n_s_per_m=20.0)
    options = ServoOptions(largest_damping_n_s_per_m=0.0, residual_limit_mj=UNBOUNDED_MJ, predict_tool=False)
    law = Sigmoid(gamma, cap)
    run = press(
        wall_model(), on_the_wall(law), VISCOUS, hand, seconds=2.0, start_mm=-1.0, options=options
    ).record
    moved = np.diff(run.xyz_mm[:, 0])
    following = run.state[:-1] == SupervisorState.OK
    expected = np.sum(0.5 * stiffness * moved[following] ** 2)
    made = run.residual_mj[-1] - run.residual_mj[np.argmax(following)]
    assert made == pytest.approx(expected, rel=0.02)


def test_what_comes_late_is_paired_with_the_motion_that_it_drove():
    """With 3 ms of delay the observer sees the energy that the delay makes, and the controller takes it."""
    options = ServoOptions(residual_limit_mj=UNBOUNDED_MJ, predict_tool=False)
    late = pushed(1.0, options, PREMIUM, delay_s=0.003)
    off = ServoOptions(largest_damping_n_s_per_m=0.0, residual_limit_mj=UNBOUNDED_MJ, predict_tool=False)
    assert pushed(1.0, off, PREMIUM, delay_s=0.003).rms_mm > 10 * late.rms_mm
    assert late.rms_mm < 0.01


def test_a_beating_wall_gives_less_than_ten_millijoules_a_cycle():
    for case in beating_walls():
        assert case.largest_by_surface_mj < 10.0
        assert case.given_mj == pytest.approx(case.by_surface_mj, abs=0.1)
    assert max(case.by_surface_mj for case in beating_walls()) > 1.0


def test_work_counts_with_the_motion_of_the_structure_that_does_it():
    """A wall that beats behind a line at rest, the primary fixture: the account is that of the wall alone."""
    law, at = Sigmoid(1.0, CAP_N), np.array([2.0, 0.0, 0.0])
    still, beating = wall_model(), wall_model(5.0)
    line = PathTarget.static("mr", [[2.0, -9.0, 0.0], [2.0, 9.0, 0.0]])
    behind = (FixtureOptions(Gaussian(3.0), path=line), FixtureOptions(law, structure=beating))
    options = ServoOptions(largest_damping_n_s_per_m=0.0, residual_limit_mj=UNBOUNDED_MJ)
    records = []
    for model, fixtures in ((beating, (FixtureOptions(law),)), (still, behind)):
        device = RecordedDevice(np.tile(at, (1800, 1)), 1000.0)
        servo = SimulatedServo(Fixtures(model, FixtureSet(fixtures)), device, options=options)
        place = Rigid.identity("tracker", "device")
        records.append(servo.run(ServoInputs(steady_transform(model), 0.0, place, valid_for_s=9.0), 1800))
    alone, both = records
    np.testing.assert_allclose(both.field_n, alone.field_n, atol=1e-6)
    np.testing.assert_allclose(both.by_surface_mj, alone.by_surface_mj, atol=1e-5)
    np.testing.assert_allclose(both.residual_mj, alone.residual_mj, atol=1e-5)
    assert np.ptp(alone.by_surface_mj) > 0.5
    assert alone.residual_mj[-1] > 1e-4
