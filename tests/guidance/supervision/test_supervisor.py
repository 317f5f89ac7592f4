"""Supervisor: fades, slew limit, clamps, latch and re-arm."""

import math

import numpy as np
import pytest
from readable_supervisor import Supervisor
from supervised_loop import CAP, NONE, TICK_S, WANTED, Loop, guiding, latched, sizes

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import HAZARD_RULES, DeviceLimits, Hazard, RearmAnswer, SupervisorState

OK, DEGRADED, FADE, LATCHED = SupervisorState


def test_the_force_begins_as_after_a_fade():
    steps = Loop().steps(120)
    assert not steps[0].force_n.any()
    assert steps[0].state is DEGRADED
    np.testing.assert_allclose(np.diff(sizes(steps))[:98], 6.0 * TICK_S)
    assert steps[-1].state is OK


@pytest.mark.parametrize(("stiffness", "slew"), [(400.0, 100.0), (1000.0, 250.0), (8.0, 2.0)])
def test_the_slew_limit_is_the_device_s(stiffness, slew):
    """Stiffness × 0.25 m/s; below 24 N/m that is less than 6 N/s, even while the force comes back."""
    loop = Loop(DeviceLimits(stiffness_n_per_m=stiffness))
    rise = loop.steps(20)
    np.testing.assert_allclose(np.diff(sizes(rise)), min(6.0, slew) * TICK_S, rtol=1e-9)
    loop.steps(400)
    cut = loop.steps(2, wanted=-WANTED)
    np.testing.assert_allclose(np.linalg.norm(cut[0].force_n - WANTED), slew * TICK_S, rtol=1e-9)
    assert cut[0].clamped


def test_a_hazard_that_flickers_withdraws_the_force_all_the_same():
    loop = guiding()
    loop.steps(1, hazards=Hazard.NO_PHASE)
    rest = loop.steps(249)
    assert {s.state for s in rest} == {FADE}
    assert (np.diff(sizes(rest)) < 0).all()
    assert not loop.steps(1)[0].force_n.any()
    largest = [sizes(loop.steps(1, hazards=Hazard.NO_PHASE) + loop.steps(9)).max() for _ in range(300)]
    assert max(largest) < 0.06


def test_a_faster_fade_takes_over_from_a_slower_one():
    loop = guiding()
    slow = loop.steps(100, hazards=Hazard.NO_PHASE)
    fast = loop.steps(21, hazards=Hazard.NO_PHASE | Hazard.NOT_FINITE)
    assert (np.diff(sizes(slow + fast)) <= 0).all()
    assert sizes(fast)[19] > 0
    assert not fast[20].force_n.any()
    assert fast[20].state is LATCHED
    assert fast[20].cause == Hazard.NO_PHASE | Hazard.NOT_FINITE


def test_a_fade_about_to_end_is_not_drawn_out_by_a_faster_one():
    loop = guiding()
    loop.steps(240, hazards=Hazard.NO_PHASE)
    last = loop.steps(11, hazards=Hazard.NOT_FINITE)
    assert sizes(last)[9] > 0
    assert not last[10].force_n.any()
    assert last[10].state is LATCHED


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_not_finite_fades_in_20_ms_and_latches(bad):
    loop = guiding()
    fade = loop.steps(21, wanted=[0.1, bad, 0.0])
    assert all(s.hazards == Hazard.NOT_FINITE for s in fade)
    assert np.isfinite([s.force_n for s in fade]).all()
    assert not fade[-1].force_n.any()
    assert fade[-1].state is LATCHED
    assert loop.rearm() is RearmAnswer.HAZARD_ACTIVE


def test_ten_cut_steps_within_a_second_latch():
    """A full reversal of 0.6 N takes twelve steps of 0.1 N."""
    loop = guiding()
    cut = loop.steps(10, wanted=-WANTED)
    assert all(s.clamped for s in cut)
    assert {s.state for s in cut[:9]} == {OK}
    assert cut[9].state is FADE
    assert cut[9].hazards == cut[9].cause == Hazard.FORCE_CLAMPED
    last = loop.steps(250)
    assert not last[-1].force_n.any()
    assert last[-1].state is LATCHED
    assert last[-1].hazards is Hazard.NONE
    assert last[-1].sentences == (HAZARD_RULES[Hazard.FORCE_CLAMPED].sentence,)
    # counting starts again after a re-arm
    loop.steps(1, wanted=NONE)
    assert loop.rearm() is RearmAnswer.ACCEPTED
    loop.steps(700)
    again = loop.steps(2, wanted=0.7 * WANTED)
    assert again[0].clamped
    assert again[1].state is OK


@pytest.mark.parametrize(("apart", "latches"), [(111, True), (112, False)])
def test_cut_steps_are_counted_over_one_second(apart, latches):
    """The first and the tenth are nine intervals apart: 0.999 s and 1.008 s."""
    loop, seen = guiding(), []
    for i in range(1, 20):
        wanted = WANTED * (0.7 if i % 2 else 1.0)
        seen += loop.steps(apart, wanted=wanted)
    assert sum(s.clamped for s in seen) == (10 if latches else 19)
    assert (seen[-1].state is not OK) == latches


def test_rearm_raises_the_force_over_half_a_second():
    loop = latched()
    assert loop.rearm() is RearmAnswer.ACCEPTED
    rise = loop.steps(700)
    expected = 0.5 * (1 - np.cos(np.pi * np.minimum(np.arange(1, 701) / 500, 1.0)))
    np.testing.assert_allclose([s.force_n for s in rise], expected[:, None] * WANTED, atol=1e-9)
    np.testing.assert_allclose([s.scale for s in rise], expected, atol=1e-9)
    assert {s.state for s in rise[:498]} == {DEGRADED}
    assert rise[-1].state is OK
    assert rise[0].cause is Hazard.NONE


def test_a_rise_after_a_rearm_begins_again_when_it_was_interrupted():
    loop = latched()
    assert loop.rearm() is RearmAnswer.ACCEPTED
    loop.steps(400)
    loop.steps(300, hazards=Hazard.NO_PHASE)
    again = sizes(loop.steps(520))
    assert again[250] < 0.35
    np.testing.assert_allclose(again[-1], CAP)


def test_the_slow_rise_belongs_to_the_rearm_alone():
    loop = latched()
    assert loop.rearm() is RearmAnswer.ACCEPTED
    loop.steps(700)
    loop.steps(300, hazards=Hazard.NO_PHASE)
    assert loop.steps(110)[-1].state is OK


def test_a_step_before_the_time_of_the_rearm_still_sends_nothing():
    loop = latched()
    assert loop.supervisor.rearm(loop.now_s + 0.05) is RearmAnswer.ACCEPTED
    assert not sizes(loop.steps(50)).any()
    assert loop.steps(2)[-1].force_n.any()


def test_rearm_is_refused_with_a_reason_and_then_dropped():
    assert guiding().rearm() is RearmAnswer.NOT_LATCHED
    assert Loop().rearm() is RearmAnswer.NOT_LATCHED
    loop = latched()
    loop.steps(1, wanted=[0.0, 0.2, 0.0])
    assert loop.rearm() is RearmAnswer.FORCE_WANTED
    assert {s.state for s in loop.steps(50, wanted=NONE)} == {LATCHED}, "a refused re-arm stayed pending"
    loop.steps(1, wanted=NONE, hazards=Hazard.NO_POSE)
    assert loop.rearm() is RearmAnswer.HAZARD_ACTIVE
    assert {s.state for s in loop.steps(50, wanted=NONE)} == {LATCHED}
    assert loop.supervisor.rearm(loop.now_s + 0.2) is RearmAnswer.NO_RECENT_STEP
    loop.steps(1, wanted=[0.0, 0.199, 0.0], hazards=Hazard.CLOCK_SKEW)
    assert loop.rearm() is RearmAnswer.ACCEPTED
    assert loop.rearm() is RearmAnswer.NOT_LATCHED


def test_a_hazard_during_a_latch_is_not_remembered_after_the_rearm():
    loop = latched()
    loop.steps(5, wanted=[math.nan, 0.0, 0.0])
    lost = loop.steps(1500, wanted=NONE, hazards=Hazard.TOOL_LOST)
    assert all(s.hazards == Hazard.TOOL_LOST and s.cause == Hazard.NOT_FINITE for s in lost)
    loop.steps(1, wanted=NONE)
    assert loop.rearm() is RearmAnswer.ACCEPTED
    loop.steps(10, wanted=NONE, hazards=Hazard.NO_PHASE)
    assert loop.steps(300)[-1].state is DEGRADED


def test_without_a_force_there_is_nothing_to_fade():
    loop = Loop()
    loop.steps(10, wanted=NONE)
    assert loop.steps(1, wanted=NONE, hazards=Hazard.NO_POSE)[0].state is FADE
    assert loop.steps(2, wanted=NONE)[-1].state is OK
    assert loop.steps(1, wanted=NONE, hazards=Hazard.NOT_FINITE)[0].state is LATCHED


def test_time_that_stands_still_gives_the_same_force():
    for loop in (Loop(), guiding()):
        last = loop.steps(50)[-1]
        for hazards in (Hazard.NONE, Hazard.NO_PHASE, Hazard.NOT_FINITE):
            again = loop.supervisor.step(loop.now_s, -WANTED, hazards)
            np.testing.assert_array_equal(again.force_n, last.force_n)
            assert not again.clamped


def test_slow_and_irregular_steps_keep_to_the_same_slew():
    supervisor = Supervisor()
    times = np.cumsum([0.0, 0.02, 0.05, 0.001, 0.03])
    forces = [supervisor.step(float(t), WANTED).force_n for t in times]
    steps = np.linalg.norm(np.diff(forces, axis=0), axis=1)
    np.testing.assert_allclose(steps[:2], [0.12, 0.3])
    np.testing.assert_allclose(steps[2], 0.006)


def test_misuse_is_refused():
    supervisor = Supervisor()
    supervisor.step(1.0, WANTED)
    for bad in (0.999, math.nan, math.inf):
        with pytest.raises(InvalidInputError, match="time of the supervisor"):
            supervisor.step(bad, WANTED)
        with pytest.raises(InvalidInputError, match="time of the supervisor"):
            supervisor.rearm(bad)
    for shape in ((2,), (4,), (1, 3)):
        with pytest.raises(InvalidInputError, match=r"needed \(3,\)"):
            supervisor.step(1.0, np.zeros(shape))
    with pytest.raises(ValueError):
        Hazard(1 << 21)
    with pytest.raises(ValueError, match="read-only"):
        supervisor.step(1.0, WANTED).force_n[0] = 1.0
