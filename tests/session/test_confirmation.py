"""A pose that nothing confirms ages until it is withheld."""

from dataclasses import replace

import numpy as np
import pytest
from dvf_ig.session.pose.registration_monitor import CONSISTENT_LOG_RATIO, confirms
from known_patient import KnownBeat

from dvf_ig.core import Rigid
from dvf_ig.registration.tracking.pose_estimate import INFORMATIVE_LOG_RATIO
from dvf_ig.session.pose_states import (
    AGEING_MM_PER_S,
    MAX_AGE_S,
    MAX_BOUND_MM,
    MAX_MISSED_BEATS,
    Confirmation,
)


def test_a_confirmed_pose_lasts_five_seconds_or_three_beats() -> None:
    assert (MAX_AGE_S, MAX_MISSED_BEATS) == (5.0, 3)
    held = Confirmation(10.0, tre_bound_mm=1.6)
    for missed in range(MAX_MISSED_BEATS):
        assert held.missed_beats == missed
        assert held.until_s == pytest.approx(15.0)
        held = held.missed()
    assert held.until_s == float("-inf")
    assert held.missed().until_s == float("-inf")
    assert held.confirmed_s == 10.0


def test_a_pose_whose_bound_passes_the_limit_is_withheld_earlier() -> None:
    held = Confirmation(10.0, tre_bound_mm=MAX_BOUND_MM - 2.0 * AGEING_MM_PER_S)
    assert held.until_s == pytest.approx(12.0)
    assert held.bound_mm(12.0) == pytest.approx(MAX_BOUND_MM)
    assert held.changed(MAX_BOUND_MM + 0.1).until_s == float("-inf")
    assert Confirmation(10.0, tre_bound_mm=1.6).bound_mm(16.0) == pytest.approx(2.6)  # 10 mm a minute


def test_a_beat_confirms_only_if_it_would_have_contradicted_a_wrong_pose() -> None:
    pose = Rigid("mr", "tracker", np.eye(3), np.zeros(3))
    agreeing = KnownBeat(0.0, 0.8, pose).evaluate_beat(pose, np.zeros(3), in_use=True).measurement
    assert confirms(agreeing)
    assert not confirms(replace(agreeing, wrong_pose_log_ratio=0.99 * INFORMATIVE_LOG_RATIO))
    assert not confirms(replace(agreeing, log_likelihood_ratio=1.01 * CONSISTENT_LOG_RATIO))
