"""A pose that nothing confirms ages until it is withheld."""

import pytest

from dvf_ig.session.confirmation import MAX_AGE_S, MAX_MISSED_BEATS, Confirmation


def test_a_confirmed_pose_lasts_five_seconds_or_three_beats() -> None:
    assert (MAX_AGE_S, MAX_MISSED_BEATS) == (5.0, 3)
    held = Confirmation(10.0)
    for missed in range(MAX_MISSED_BEATS):
        assert held.missed_beats == missed
        assert held.until_s == pytest.approx(15.0)
        held = held.missed()
    assert held.until_s == float("-inf")
    assert held.missed().until_s == float("-inf")
    assert held.confirmed_s == 10.0
