"""`dvf-ig bench --session`: streams that go on without an end, and what is measured of a session on them."""

from itertools import takewhile

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError, PhaseState, Scenario
from dvf_ig.replay import Replay
from dvf_ig.session import EcgSamples, EcgSource, Session, ToolPose, TrackedFrame
from dvf_ig.session.clocks import HeartClock
from dvf_ig.study.bench.session import OUT_OF_SIGHT_S, Round, round_of, run_session


@pytest.fixture(scope="module")
def recorded(scenario: Scenario) -> Round:
    return round_of(scenario)


def test_rounds_follow_each_other_without_a_gap(recorded: Round) -> None:
    until_s = recorded.begin_s + 3 * recorded.seconds
    events = list(takewhile(lambda timed: timed[0] < until_s, recorded.events()))
    assert [t_s for t_s, _ in events] == sorted(t_s for t_s, _ in events)
    for kind, period_s in ((ToolPose, 0.010), (TrackedFrame, 1 / 12)):
        steps = np.diff([event.t_s for _, event in events if isinstance(event, kind)])
        assert steps.min() > 0.0
        assert steps.max() < 2.5 * period_s
    chunks = [event for _, event in events if isinstance(event, EcgSamples)]
    ends = [chunk.start_s + len(chunk.samples) / recorded.rate_hz for chunk in chunks]
    np.testing.assert_allclose(ends[:-1], [chunk.start_s for chunk in chunks[1:]], atol=1e-9)
    seam_s = recorded.begin_s + recorded.seconds
    hidden = [e for t, e in events if seam_s - OUT_OF_SIGHT_S + 1e-6 < t < seam_s - 1e-6]
    assert all(e.tracker_from_tool is None for e in hidden if isinstance(e, ToolPose))
    assert all(e.tracker_from_probe is None for e in hidden if isinstance(e, TrackedFrame))


def test_the_rhythm_goes_on_at_the_seam(recorded: Round) -> None:
    clock, states = HeartClock(EcgSource(recorded.rate_hz)), []
    until_s = recorded.begin_s + 3 * recorded.seconds
    for t_s, event in takewhile(lambda timed: timed[0] < until_s, recorded.events()):
        if isinstance(event, EcgSamples):
            clock.push(event)
            while clock.next_s <= t_s:
                clock.step()
            states.append((t_s, clock.forecast(t_s).state))
    locked = [state is PhaseState.LOCKED for t_s, state in states if t_s > recorded.begin_s + 8.0]
    assert np.mean(locked) > 0.97


@pytest.mark.usefixtures("known_registrations")
def test_a_session_is_measured(replay: Replay, recorded: Round) -> None:
    done = run_session(replay.setup, recorded, 15.0)
    state, beat = done.rows
    assert (state.what, beat.what) == ("session state", "session beat")
    assert 0.0 < state.median_us < state.p99_us < state.max_us
    assert done.beats > 0
    assert done.registrations > 0
    assert 0.0 < done.served_share < 1.0
    assert done.real_time_factor == pytest.approx(done.seconds / done.computing_s)
    with pytest.raises(InvalidInputError, match="at least 15 s"):
        run_session(replay.setup, recorded, 5.0)


def test_a_state_keeps_its_arrays_when_the_next_is_asked_for(replay: Replay) -> None:
    with Session(replay.setup) as session:
        first, second = session.state(0.0), session.state(0.001)
    for name in ("wanted_n", "gradient"):
        before, after = getattr(first, name), getattr(second, name)
        assert not before.flags.writeable
        assert not np.shares_memory(before, after)
