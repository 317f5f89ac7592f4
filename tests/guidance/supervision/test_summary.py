"""Summary of what a supervisor did: seconds in each state, fades, latches, largest step."""

import numpy as np
import pytest
from readable_supervisor import Supervisor

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance import SupervisorState, summarise_supervision

OK, DEGRADED, FADE, LATCHED = (int(s) for s in SupervisorState)


def test_a_state_lasts_until_the_next_step():
    t_s = np.array([0.0, 0.5, 1.5, 2.0, 4.0, 4.25])
    state = np.array([FADE, DEGRADED, OK, FADE, LATCHED, FADE])
    force = np.zeros((6, 3))
    force[2] = [0.3, 0.4, 0.0]
    force[3] = [0.3, 0.0, 0.0]
    summary = summarise_supervision(t_s, state, force)
    assert (summary.ok_s, summary.degraded_s, summary.fade_s, summary.latched_s) == (0.5, 1.0, 2.5, 0.25)
    assert summary.fades == 2
    assert summary.latches == 1
    assert summary.largest_step_n == pytest.approx(0.5)
    assert summary.largest_slew_n_per_s == pytest.approx(0.8)


def test_one_step_is_no_time():
    summary = summarise_supervision(np.zeros(1), np.array([OK]), np.ones((1, 3)))
    assert (summary.ok_s, summary.fades, summary.largest_step_n, summary.largest_slew_n_per_s) == (0, 0, 0, 0)


def test_the_slew_of_a_supervised_force_is_below_its_limit():
    supervisor = Supervisor()
    t_s = np.arange(500) * 0.001
    steps = [supervisor.step(float(t), np.array([0.6 if t < 0.4 else 0.3, 0.0, 0.0])) for t in t_s]
    summary = summarise_supervision(
        t_s, np.array([s.state for s in steps]), np.array([s.force_n for s in steps])
    )
    assert summary.largest_slew_n_per_s == pytest.approx(100.0)
    assert summary.ok_s > 0.39


def test_senseless_recordings_are_refused():
    with pytest.raises(InvalidInputError, match="times that increase"):
        summarise_supervision(np.zeros(2), np.zeros(2, int), np.zeros((2, 3)))
    with pytest.raises(InvalidInputError, match="at least one"):
        summarise_supervision(np.zeros(0), np.zeros(0, int), np.zeros((0, 3)))
    with pytest.raises(InvalidInputError, match="sent force"):
        summarise_supervision(np.arange(2.0), np.zeros(2, int), np.zeros((3, 3)))
