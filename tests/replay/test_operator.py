"""The operator of a replay re-arms a second after what latched the force has gone, and not before."""

from types import SimpleNamespace

import pytest

from dvf_ig.guidance import Hazard, SupervisorState
from dvf_ig.replay.engine import REARM_AFTER_S, SimulatedOperator
from dvf_ig.session import Rearm

LATCHED, OK = SupervisorState.LATCHED, SupervisorState.OK
STEP_S = 0.01


def actions(*phases: tuple[float, SupervisorState, Hazard]) -> list[Rearm]:
    """What the operator does while each of the phases (seconds, state, hazards) lasts."""
    operator, found, ticks = SimulatedOperator(), [], 0
    for seconds, state, hazards in phases:
        for _ in range(round(seconds / STEP_S)):
            supervised = SimpleNamespace(hazards=hazards)
            said = SimpleNamespace(now_s=STEP_S * ticks, supervisor=state, supervised=supervised)
            action = operator.action(said)
            found += [] if action is None else [action]
            ticks += 1
    return found


def test_nothing_is_done_unless_the_force_is_latched() -> None:
    for state in SupervisorState:
        assert bool(actions((3.0, state, Hazard.NONE))) == (state is LATCHED)


def test_a_rearm_waits_a_second_after_the_hazard_has_gone() -> None:
    (first, second) = actions((2.0, LATCHED, Hazard.TOOL_LOST), (2.5, LATCHED, Hazard.NONE))
    assert first.t_s == pytest.approx(2.0 + REARM_AFTER_S, abs=STEP_S)
    assert second.t_s == pytest.approx(first.t_s + REARM_AFTER_S, abs=STEP_S)


def test_a_hazard_that_comes_again_starts_the_second_anew() -> None:
    lost = (0.01, LATCHED, Hazard.STALE_TOOL)
    assert not actions((0.9, LATCHED, Hazard.NONE), lost, (0.9, LATCHED, Hazard.NONE))


def test_a_warning_does_not_keep_the_operator_waiting() -> None:
    assert actions((1.5, LATCHED, Hazard.REORDERED_STAMPS | Hazard.POSE_MOVING))


def test_every_latch_is_answered_anew() -> None:
    wait = (1.2, LATCHED, Hazard.NONE)
    assert len(actions(wait, (5.0, OK, Hazard.NONE), wait)) == 2
