"""The hazard table: what each hazard does to the force, and how the force comes back or latches."""

import numpy as np
import pytest
from supervised_loop import TICK_S, WANTED, guiding, sizes

from dvf_ig.guidance import HAZARD_RULES, Hazard, Latch, Status, SupervisorState
from dvf_ig.guidance.supervision.hazards import hazard_of, hazards_that_latch

OK, DEGRADED, FADE, LATCHED = SupervisorState
FADING = [
    (Hazard.STALE_TOOL, 0.250, Latch.AFTER_1_S),
    (Hazard.TOOL_LOST, 0.250, Latch.AFTER_1_S),
    (Hazard.TOOL_FROZEN, 0.250, Latch.AFTER_1_S),
    (Hazard.LATENCY_JUMP, 0.250, Latch.NEVER),
    (Hazard.CLOCK_BACKWARDS, 0.250, Latch.AFTER_1_S),
    (Hazard.NO_PHASE, 0.250, Latch.NEVER),
    (Hazard.NO_POSE, 0.250, Latch.NEVER),
    (Hazard.POSE_UNCONFIRMED, 0.250, Latch.NEVER),
    (Hazard.BREATHING, 0.250, Latch.NEVER),
    (Hazard.POSE_CONTRADICTED, 0.250, Latch.NEVER),
    (Hazard.OUT_OF_VOLUME, 0.250, Latch.NEVER),
    (Hazard.NOT_FINITE, 0.020, Latch.AT_ONCE),
    (Hazard.SESSION_SILENT, 0.250, Latch.AFTER_1_S),
    (Hazard.DEVICE_LOST, 0.020, Latch.AT_ONCE),
    (Hazard.ENERGY, 0.250, Latch.AT_ONCE),
    (Hazard.MISSED_DEADLINES, 0.0, Latch.AT_ONCE),
    (Hazard.TOOL_CONTRADICTED, 0.250, Latch.AFTER_1_S),
]
GIVEN_IN_FULL = [Hazard.REORDERED_STAMPS, Hazard.CLOCK_SKEW]


def test_the_cases_are_the_whole_table():
    cases = [h for h, _, _ in FADING] + GIVEN_IN_FULL + [Hazard.POSE_MOVING, Hazard.FORCE_CLAMPED]
    assert sorted(cases) == sorted(HAZARD_RULES) == sorted(Hazard)


@pytest.mark.parametrize(("hazard", "fade_s", "latch"), FADING, ids=lambda v: getattr(v, "name", ""))
def test_a_hazard_releases_the_sent_force_by_a_raised_cosine(hazard, fade_s, latch):
    """|F| = ½(1 + cos πτ/T) of what was sent before, along the same line, whatever is wanted meanwhile."""
    loop = guiding()
    ticks = round(fade_s / TICK_S)
    fade = loop.steps(ticks + 5, wanted=[-0.6, 0.0, 0.0], hazards=hazard)
    tau = np.arange(ticks) / ticks
    expected = 0.5 * (1 + np.cos(np.pi * tau))
    np.testing.assert_allclose([s.scale for s in fade[:ticks]], expected, atol=1e-9)
    forces = np.array([s.force_n for s in fade[:ticks]]).reshape(-1, 3)
    np.testing.assert_allclose(forces, expected[:, None] * WANTED, atol=1e-9)
    assert not sizes(fade[ticks:]).any()
    assert {s.state for s in fade[:ticks]} <= {FADE}
    assert all(
        s.hazards == s.cause == hazard and s.sentences == (HAZARD_RULES[hazard].sentence,) for s in fade
    )
    assert fade[-1].state is (LATCHED if latch is Latch.AT_ONCE else FADE)


@pytest.mark.parametrize(("hazard", "fade_s", "latch"), FADING, ids=lambda v: getattr(v, "name", ""))
def test_a_hazard_that_goes_lets_the_force_back_or_not(hazard, fade_s, latch):
    """0.6 N at 6 N/s take 100 ms, unless the hazard latches at once."""
    loop = guiding()
    loop.steps(400, hazards=hazard)
    back = loop.steps(130)
    if latch is Latch.AT_ONCE:
        assert {s.state for s in back} == {LATCHED}
        assert not sizes(back).any()
        assert back[-1].cause == hazard
        assert back[-1].hazards is Hazard.NONE
        return
    assert np.diff(sizes(back)).max() <= 6.0 * TICK_S * (1 + 1e-9)
    assert {s.state for s in back[:90]} == {DEGRADED}
    assert all(s.sentences == () for s in back)
    assert back[-1].state is OK
    np.testing.assert_array_equal(back[-1].force_n, WANTED)
    assert not any(s.clamped for s in back)


@pytest.mark.parametrize(("hazard", "fade_s", "latch"), FADING, ids=lambda v: getattr(v, "name", ""))
def test_a_hazard_that_lasts_for_a_second_latches_or_not(hazard, fade_s, latch):
    loop = guiding()
    before = loop.steps(1000, hazards=hazard)
    after = loop.steps(5000, hazards=hazard)
    if latch is not Latch.AT_ONCE:
        assert {s.state for s in before} == {FADE}
    assert {s.state for s in after} == {FADE if latch is Latch.NEVER else LATCHED}
    assert not sizes(after).any()
    assert (loop.steps(1)[-1].state is LATCHED) == (latch is not Latch.NEVER)


def test_hazards_that_latch_share_one_second():
    """The tool is lost, then frozen, then stale: away for a second throughout."""
    loop = guiding()
    loop.steps(400, hazards=Hazard.TOOL_LOST)
    loop.steps(400, hazards=Hazard.TOOL_FROZEN | Hazard.CLOCK_SKEW)
    last = loop.steps(201, hazards=Hazard.STALE_TOOL)[-1]
    assert last.state is LATCHED
    assert last.cause == Hazard.TOOL_LOST | Hazard.TOOL_FROZEN | Hazard.STALE_TOOL
    loop = guiding()
    loop.steps(700, hazards=Hazard.TOOL_LOST)
    loop.steps(1)
    assert loop.steps(700, hazards=Hazard.TOOL_LOST)[-1].state is FADE


@pytest.mark.parametrize("hazard", GIVEN_IN_FULL)
def test_a_warning_leaves_the_force_as_it_is(hazard):
    loop = guiding()
    warned = loop.steps(2000, hazards=hazard)
    assert {s.state for s in warned} == {DEGRADED}
    assert all(np.array_equal(s.force_n, WANTED) for s in warned)
    assert warned[-1].sentences == (HAZARD_RULES[hazard].sentence,)
    assert warned[-1].cause is Hazard.NONE
    assert loop.steps(1)[-1].state is OK


def test_a_registration_update_slows_the_force_and_latches_nothing():
    loop = guiding()
    moving = loop.steps(60, wanted=-WANTED, hazards=Hazard.POSE_MOVING)
    forces = np.array([s.force_n for s in moving])
    assert np.linalg.norm(np.diff(forces, axis=0), axis=1).max() <= 6.0 * TICK_S * (1 + 1e-9)
    assert {s.state for s in moving} == {DEGRADED}
    # what is left to catch up after the update is no jump either
    after = loop.steps(200, wanted=-WANTED)
    forces = np.array([s.force_n for s in moving + after])
    assert np.linalg.norm(np.diff(forces, axis=0), axis=1).max() <= 6.0 * TICK_S * (1 + 1e-9)
    assert after[-1].state is OK
    assert not any(s.clamped for s in moving + after)


def test_every_status_of_a_force_is_a_hazard():
    assert hazard_of(Status.OK) is Hazard.NONE
    assert hazard_of(Status.UNSEEN) is hazard_of(Status.OUT_OF_VOLUME)  # unprotected, both
    named = [hazard_of(status) for status in Status if status not in (Status.OK, Status.UNSEEN)]
    assert len(set(named)) == len(named)
    assert Hazard.NONE not in named


def test_what_says_nothing_of_its_own_return_latches():
    late, at_once = hazards_that_latch(Latch.AFTER_1_S), hazards_that_latch(Latch.AT_ONCE)
    tool = Hazard.STALE_TOOL | Hazard.TOOL_LOST | Hazard.TOOL_FROZEN | Hazard.CLOCK_BACKWARDS
    assert late == tool | Hazard.TOOL_CONTRADICTED | Hazard.SESSION_SILENT
    found_by_servo = Hazard.DEVICE_LOST | Hazard.ENERGY | Hazard.MISSED_DEADLINES
    assert at_once == Hazard.NOT_FINITE | Hazard.FORCE_CLAMPED | found_by_servo
