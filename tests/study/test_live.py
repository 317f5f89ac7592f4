"""What is compared between a live session and a replay: on samples made here, with a known difference."""

import numpy as np
import pytest

from dvf_ig.study.live import _apart, _settled


def test_force_after_a_known_latency():
    at_s = np.arange(0.0, 10.0, 0.001)
    force = np.column_stack([np.sin(at_s), np.cos(at_s), np.zeros(len(at_s))])
    t_s = np.arange(1.0, 9.0, 1.0 / 60.0)
    late = np.column_stack([np.sin(t_s - 0.012), np.cos(t_s - 0.012), np.zeros(len(t_s))])
    assert _apart(t_s, late, at_s, force).max() == pytest.approx(0.012, abs=1e-4)
    assert _apart(t_s - 0.012, late, at_s, force).max() < 1e-6


def test_force_is_compared_a_second_after_it_was_withheld():
    t_s = np.arange(0.0, 5.0, 0.1)
    codes = np.where((t_s > 1.95) & (t_s < 2.25), 2, 0)
    settled = _settled(t_s, codes)
    assert settled[t_s < 1.9].all()
    assert not settled[(t_s > 1.95) & (t_s < 3.15)].any()
    assert settled[t_s > 3.35].all()
