"""A session whose beats come from a hardware trigger: guided as by an ECG, and no force where it fails."""

from dataclasses import replace

import numpy as np
import pytest
from toy_session import GUIDED_S, RR_S, ecg_of, stamp, ticks, toy_setup, toy_streams

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.guidance import Hazard, Status
from dvf_ig.session import EcgSamples, Event, GuidanceState, Session, Trigger, TriggerSource

END_S, DELAY_S = 18.0, 0.03
R_PEAKS = np.arange(0.4, END_S, RR_S)


def triggered(fired_s: FloatArray, *, delay_s: float = DELAY_S) -> list[GuidanceState]:
    """States from GUIDED_S on, with pulses at these times."""
    streams = toy_streams(END_S)
    pulses: list[Event] = [Trigger(t_s) for t_s in fired_s.tolist()]
    events = sorted([*pulses, *streams.frames, *streams.tool, *streams.others], key=stamp)
    states = []
    with Session(replace(toy_setup(), beat_source=TriggerSource(delay_s))) as session:
        pushed = 0
        for now_s in ticks(GUIDED_S, END_S - 0.5):
            while pushed < len(events) and stamp(events[pushed]) <= now_s:
                session.push(events[pushed])
                pushed += 1
            states.append(session.state(now_s))
    return states


def forces_n(states: list[GuidanceState], from_s: float, until_s: float) -> FloatArray:
    return np.array([np.linalg.norm(s.force_n) for s in states if from_s <= s.now_s < until_s])


@pytest.mark.usefixtures("known_ultrasound")
def test_a_trigger_guides_as_an_ecg_does() -> None:
    states = triggered(R_PEAKS + DELAY_S)
    assert forces_n(states, GUIDED_S + 1.0, END_S).min() > 0.1
    errors = [abs((s.phase.phi - (s.now_s - 0.4) / RR_S + 0.5) % 1.0 - 0.5) for s in states]
    assert max(errors) < 1e-6


@pytest.mark.usefixtures("known_ultrasound")
def test_a_trigger_that_stops_leaves_the_wall_of_the_worst_phase() -> None:
    last_s = float(R_PEAKS[R_PEAKS < 14.5][-1]) + DELAY_S
    states = triggered(R_PEAKS[R_PEAKS < 14.5] + DELAY_S)
    assert forces_n(states, GUIDED_S + 1.0, last_s + 1.3 * RR_S).min() > 0.1
    assert forces_n(states, last_s + 1.5 * RR_S + 0.25, last_s + 4.0 * RR_S).min() > 0.1
    assert states[-1].supervised.hazards & Hazard.NO_PHASE
    assert states[-1].status is Status.NO_PHASE


@pytest.mark.usefixtures("known_ultrasound")
def test_a_double_pulse_leaves_the_wall_of_the_worst_phase() -> None:
    double_s = float(R_PEAKS[R_PEAKS > 14.0][0]) + DELAY_S + 0.1
    states = triggered(np.sort(np.append(R_PEAKS + DELAY_S, double_s)))
    assert forces_n(states, double_s - 0.2, double_s).min() > 0.1
    later = [s for s in states if double_s + 0.05 <= s.now_s < double_s + 3.0 * RR_S]
    assert {s.status for s in later} == {Status.NO_PHASE}
    assert min(np.linalg.norm(s.force_n) for s in later) > 0.1


def test_an_event_of_the_other_source_is_refused() -> None:
    with Session(toy_setup()) as session, pytest.raises(InvalidInputError, match="Trigger came to a session"):
        session.push(Trigger(1.0))
    setup = replace(toy_setup(), beat_source=TriggerSource())
    with Session(setup) as session, pytest.raises(InvalidInputError, match="EcgSamples came to a session"):
        session.push(EcgSamples(0.0, ecg_of(0.0, 1.0)))
    with pytest.raises(InvalidInputError, match="is it in ms"):
        Session(replace(toy_setup(), beat_source=TriggerSource(30.0)))
    with pytest.raises(InvalidInputError, match="finite time"):
        Trigger(np.nan)
