"""Stamps of a stream keep their order, and the clocks of sources are followed."""

import numpy as np
import pytest

from dvf_ig.core import FloatArray
from dvf_ig.guidance.supervision.supervisor import LATCH_AFTER_S
from dvf_ig.session import EcgSamples, EcgSource, Landmark, ToolPose
from dvf_ig.session.clocks import (
    DEGRADED_SHARE,
    JITTER_S,
    LARGEST_RATE,
    STEADY_S,
    WINDOW,
    SourceClock,
    SourceClocks,
    StampOrder,
)

LATENCY_S = 0.004


def stamps(
    clock: SourceClock, seconds: float, rate: float, *, seed: int = 1, late_s: float = 0.0
) -> FloatArray:
    """(n, 3) arrival, stamp on the local clock, whether skewed; 100 Hz, fast by `rate`."""
    rng, rows = np.random.default_rng(seed), []
    for t_s in (np.arange(round(100 * seconds)) / 100).tolist():
        arrived_s = t_s + LATENCY_S + float(rng.exponential(0.0005)) + (late_s if t_s > 30.0 else 0.0)
        local_s = clock.local_s(t_s * (1.0 + rate), arrived_s)
        rows.append((arrived_s, np.nan if local_s is None else local_s, clock.skewed))
    return np.array(rows)


@pytest.mark.parametrize("rate", [30e-6, -30e-6])
def test_a_crystal_is_followed_without_a_word(rate: float) -> None:
    clock = SourceClock()
    rows = stamps(clock, 600.0, rate)
    assert not rows[:, 2].any()
    true_s = np.arange(len(rows)) / 100
    assert np.abs(rows[:, 1] - true_s)[1000:].max() < 0.0006
    assert clock.correction_s == pytest.approx(-600.0 * rate, abs=0.0006)


@pytest.mark.parametrize("rate", [150e-6, -150e-6])
def test_a_drift_beyond_100_ppm_is_told_and_followed(rate: float) -> None:
    rows = stamps(SourceClock(), 120.0, rate)
    assert 35.0 < rows[np.flatnonzero(rows[:, 2])[0], 0] < 50.0
    assert np.abs(rows[:, 1] - np.arange(len(rows)) / 100)[1000:].max() < 0.001


def test_a_stamp_from_the_future_is_replaced_by_its_arrival() -> None:
    clock = SourceClock()
    stamps(clock, 10.0, 0.0)
    assert clock.local_s(10.02, 10.01) == 10.01
    assert clock.skewed
    assert clock.local_s(10.02, 10.024) == pytest.approx(10.02, abs=1e-3)
    assert not clock.skewed


def test_samples_of_a_clock_that_went_back_are_refused_until_it_is_back() -> None:
    clock = SourceClock()
    stamps(clock, 10.0, 0.0)
    assert clock.local_s(9.7, 10.004) is None
    assert clock.local_s(9.99, 10.294) is None, "later than all before, and 0.3 s off"
    assert clock.behind
    assert clock.local_s(10.3, 10.304) == pytest.approx(10.3, abs=1e-3)
    assert not clock.behind


def test_a_link_that_becomes_slow_is_not_taken_for_a_clock_at_once() -> None:
    rows = stamps(SourceClock(), 40.0, 0.0, late_s=0.02)
    moved_s = rows[:, 1] - np.arange(len(rows)) / 100
    assert 0.5 * LARGEST_RATE * 10.0 < moved_s[-1] <= LARGEST_RATE * 10.0
    assert rows[-1, 2]


def test_each_kind_of_event_has_its_own_clock_and_an_operators_action_none() -> None:
    clocks = SourceClocks(EcgSource(500.0))
    ahead = clocks.on_local_clock(ToolPose(1.5, None), 1.0)
    assert isinstance(ahead, ToolPose)
    assert ahead.t_s == 1.0
    assert clocks.skewed
    packet = EcgSamples(0.9, np.zeros((50, 1)))
    assert clocks.on_local_clock(packet, 1.01) is packet
    ahead_s = clocks.on_local_clock(EcgSamples(2.0, np.zeros((50, 1))), 1.11)
    assert isinstance(ahead_s, EcgSamples)
    assert ahead_s.start_s == pytest.approx(1.11 - 49 / 500)
    landmark = Landmark(1.0, "apex", np.zeros(3), np.zeros(3))
    assert clocks.on_local_clock(landmark, 5.0) is landmark


def after_jump(clock: SourceClock, by_s: float, seconds: float) -> FloatArray:
    """(n, 3) arrival, local stamp, whether behind, of a clock that ran for 10 s and then jumped; 100 Hz."""
    stamps(clock, 10.0, 0.0)
    rows = []
    for t_s in (10.0 + np.arange(round(100 * seconds)) / 100).tolist():
        local_s = clock.local_s(t_s + by_s, t_s + LATENCY_S)
        rows.append((t_s + LATENCY_S, np.nan if local_s is None else local_s, clock.behind))
    return np.array(rows)


def test_a_source_that_restarts_with_an_earlier_clock_is_followed_when_the_force_has_latched() -> None:
    arrived_s, local_s, behind = after_jump(SourceClock(), -9.0, 60.0).T
    back = int(np.flatnonzero(behind == 0.0)[0])
    assert STEADY_S <= arrived_s[back] - arrived_s[0] < STEADY_S + 0.02
    assert STEADY_S > LATCH_AFTER_S + 0.5
    assert np.isnan(local_s[:back]).all()
    assert np.abs(arrived_s - LATENCY_S - local_s)[back:].max() < 1e-3
    assert not behind[back:].any()


def test_a_clock_that_went_ahead_is_followed_and_no_longer_called_skewed() -> None:
    clock = SourceClock()
    arrived_s, local_s, _ = after_jump(clock, 500.0, 60.0).T
    assert np.abs(arrived_s - local_s).max() <= LATENCY_S + 1e-3
    assert np.abs(arrived_s - LATENCY_S - local_s)[210:].max() < 1e-3
    assert not clock.skewed


def test_a_first_stamp_far_ahead_and_a_jump_in_the_first_seconds_do_no_harm() -> None:
    clock = SourceClock()
    assert clock.local_s(50.0, 0.0) == 0.0
    for t_s in (np.arange(1, 1000) / 100).tolist():
        by_s = 100.0 if t_s > 2.0 else 0.0
        local_s = clock.local_s(t_s + by_s, t_s + LATENCY_S)
        assert local_s is not None
        assert abs(local_s - t_s) <= LATENCY_S + 1e-9


def test_samples_of_an_older_clock_between_those_of_the_right_one_are_refused_for_ever() -> None:
    clock = SourceClock()
    stamps(clock, 10.0, 0.0)
    for t_s in (10.0 + np.arange(1000) / 100).tolist():
        assert clock.local_s(t_s, t_s + LATENCY_S) == pytest.approx(t_s, abs=1e-3)
        assert clock.local_s(t_s - 9.0, t_s + LATENCY_S) is None


# ------------------------------------------------------------------ order of stamps


def after(*stamps_s: float, now_s: float = 1e9) -> tuple[list[bool], StampOrder]:
    order = StampOrder()
    accepted = [order.accepts(t_s) for t_s in stamps_s]
    order.advance(now_s)
    return accepted, order


def test_only_later_samples_are_accepted() -> None:
    accepted, order = after(1.0, 1.0, 2.0, 1.95, 2.0, 2.1)
    assert accepted == [True, False, True, False, False, True]
    assert order.newest_s == 2.1
    assert not order.restarted
    assert not order.disordered


def test_a_clock_that_went_back_is_refused_until_it_has_caught_up() -> None:
    accepted, order = after(10.0, 10.0 - JITTER_S - 0.01, 9.99)
    assert accepted == [True, False, False]
    assert order.restarted
    accepted, order = after(10.0, 10.0 - JITTER_S - 0.01, 9.99, 10.01)
    assert accepted[-1]
    assert not order.restarted
    assert not after(10.0, 10.0 - 0.99 * JITTER_S)[1].restarted


@pytest.mark.parametrize("dropped", [int(DEGRADED_SHARE * WINDOW), int(DEGRADED_SHARE * WINDOW) + 1])
def test_more_than_a_tenth_dropped_degrades(dropped: int) -> None:
    stamps = [float(k) for k in range(WINDOW)]
    _, order = after(*stamps, *[stamps[-1]] * dropped)
    assert order.disordered == (dropped > DEGRADED_SHARE * WINDOW)
    for k in range(WINDOW):
        order.accepts(stamps[-1] + 1.0 + k)
    order.advance(1e9)
    assert not order.disordered


def test_what_arrives_ahead_of_time_counts_from_its_stamp() -> None:
    """A sample behind another counts from the stamp of that one, for it cannot have come before."""
    order = StampOrder()
    for t_s in (1.0, 5.0, 2.0, 6.0):
        order.accepts(t_s)
    seen = []
    for now_s in (1.0, 4.9, 5.0, 5.9, 6.0):
        order.advance(now_s)
        seen.append(order.restarted)
    assert seen == [False, False, True, True, False]


def test_a_stamp_far_ahead_leaves_no_growing_memory() -> None:
    order = StampOrder()
    for t_s in [1.0, 1e6, *(2.0 + k for k in range(10 * WINDOW))]:
        order.accepts(t_s)
    order.advance(1e4)
    assert len(order._waiting) <= WINDOW + 1
