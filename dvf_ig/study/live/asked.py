"""A recording pushed as it happened, with the state asked for at the moments of a live session."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Scenario, read_only_arrays
from dvf_ig.replay.events import events_of
from dvf_ig.session import Session, SessionSetup


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AskedStates:
    """What a session answers to which nothing comes late.

    Attributes:
        force_n: (n, 3) in frame "tracker".
        status, supervisor: (n,) codes.
        tool_age_s: (n,) of the newest pose of the tool.
    """

    force_n: FloatArray
    status: IntArray
    supervisor: IntArray
    tool_age_s: FloatArray


def asked_at(scenario: Scenario, setup: SessionSetup, t_s: FloatArray) -> AskedStates:
    """States at (n,) times in order, by the recording's clock.

    Between two ticks of a replay a pose may have come: the force between them is that of neither.
    """
    events = events_of(scenario)
    upcoming = next(events)
    states = []
    with Session(setup) as session:
        for now_s in t_s.tolist():
            while upcoming[0] <= now_s:
                session.push(upcoming[1])
                upcoming = next(events, (np.inf, upcoming[1]))
            states.append(session.state(now_s))
    return AskedStates(
        np.array([state.force_n for state in states]).reshape(-1, 3),
        np.array([int(state.status) for state in states], dtype=np.int64),
        np.array([int(state.supervisor) for state in states], dtype=np.int64),
        np.array([state.tool.age_s for state in states]),
    )
