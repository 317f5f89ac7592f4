"""The heart's clock of a session: R peaks count from their detection, and samples know no future."""

import numpy as np
import pytest
from toy_session import ECG_HZ, RR_S, ecg_events, ecg_of

from dvf_ig.cardiac import RPeak
from dvf_ig.core import FloatArray, InvalidInputError, PhaseState
from dvf_ig.session import EcgSamples, EcgSource, Trigger, TriggerSource
from dvf_ig.session.clocks import HeartClock


def pushed(samples: FloatArray, *, chunk: int = 50) -> HeartClock:
    clock = HeartClock(EcgSource(ECG_HZ))
    for event in ecg_events(samples, chunk=chunk):
        clock.push(event)
    return clock


def stepped(clock: HeartClock, until_s: float) -> list[RPeak]:
    peaks = []
    while clock.next_s <= until_s:
        at_s = clock.next_s
        peak = clock.step()
        if peak is not None:
            assert peak.detected_at_s == at_s
            assert peak.t_s < at_s
            peaks.append(peak)
    return peaks


def test_every_beat_is_found_and_the_phase_locks() -> None:
    clock = pushed(ecg_of(0.0, 12.0))
    peaks = stepped(clock, 12.0)
    found = np.array([p.t_s for p in peaks if p.t_s > 3.0])
    expected = np.arange(0.4, 12.0, RR_S)
    np.testing.assert_allclose(found, expected[(expected > 3.0) & (expected < 11.7)], atol=0.003)
    reading = clock.forecast(11.9).at(11.9)
    assert reading.state is PhaseState.LOCKED
    assert reading.rr_s == pytest.approx(RR_S, abs=0.002)
    assert reading.phi == pytest.approx((11.9 - 0.4) / RR_S % 1.0, abs=0.01)


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_pieces_change_nothing(chunk: int) -> None:
    samples = ecg_of(0.0, 10.0)
    assert stepped(pushed(samples, chunk=chunk), 10.0) == stepped(pushed(samples), 10.0)


def test_nothing_waits_before_the_first_sample_and_after_the_last_peak() -> None:
    clock = HeartClock(EcgSource(ECG_HZ))
    assert clock.next_s == np.inf
    assert clock.forecast(5.0).state is PhaseState.INIT
    clock = pushed(ecg_of(0.0, 5.0))
    stepped(clock, 5.0)
    assert clock.next_s == np.inf


@pytest.mark.parametrize("value", [0.2, np.nan])
def test_an_ecg_that_is_flat_or_missing_for_a_fifth_of_a_second_is_lost(value: float) -> None:
    samples = ecg_of(0.0, 12.0)
    samples[round(10.0 * ECG_HZ) :] = value
    clock = pushed(samples)
    stepped(clock, 10.19)
    assert clock.forecast(10.19).at(10.19).state is PhaseState.LOCKED
    stepped(clock, 10.21)
    assert clock.forecast(10.21).at(10.21).state is PhaseState.LOST


def test_a_gap_is_known_when_samples_come_again() -> None:
    """Before, nobody could tell that any were missing: a state must not depend on what is pushed ahead."""
    samples = ecg_of(0.0, 12.0)
    clock = HeartClock(EcgSource(ECG_HZ))
    for event in ecg_events(samples):
        if not 10.2 <= event.start_s < 10.59:
            clock.push(event)
    stepped(clock, 10.59)
    assert clock.forecast(10.59).at(10.59).state is PhaseState.LOCKED
    stepped(clock, 10.6)
    assert clock.forecast(10.601).at(10.601).state is PhaseState.LOST


def test_samples_that_do_not_fit_are_refused() -> None:
    clock = pushed(ecg_of(0.0, 2.0))
    with pytest.raises(InvalidInputError, match=r"shape \(3, 2\); needed \(n, 1\)"):
        clock.push(EcgSamples(2.0, np.zeros((3, 2))))


def test_samples_that_come_twice_or_behind_others_are_dropped_and_counted() -> None:
    whole = ecg_events(ecg_of(0.0, 12.0), chunk=5)
    expected = pushed(ecg_of(0.0, 12.0))
    stepped(expected, 12.0)
    clock = HeartClock(EcgSource(ECG_HZ))
    for event in whole:
        clock.push(event)
        clock.push(event)
    stepped(clock, 12.0)
    clock.order.advance(12.0)
    assert clock.order.disordered
    assert not clock.order.restarted
    assert clock.forecast(12.0) == expected.forecast(12.0)
    clock.push(EcgSamples(10.0, np.zeros((5, 1))))
    clock.order.advance(12.0)
    assert clock.order.restarted


def test_a_trigger_behind_the_last_one_is_dropped() -> None:
    expected, clock = HeartClock(TriggerSource(0.02)), HeartClock(TriggerSource(0.02))
    for k in range(10):
        expected.push(Trigger(0.8 * k))
        clock.push(Trigger(0.8 * k))
        clock.push(Trigger(0.8 * k - 0.05))
    stepped(expected, 8.0)
    stepped(clock, 8.0)
    assert clock.forecast(8.0) == expected.forecast(8.0)
