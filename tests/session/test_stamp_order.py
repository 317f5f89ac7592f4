"""Stamps of a stream: what repeats or comes late is dropped, much of it degrades, a restart is refused."""

import pytest

from dvf_ig.session.clocks import DEGRADED_SHARE, JITTER_S, WINDOW, StampOrder


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
