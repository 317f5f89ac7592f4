"""Supervisor: what holds in any sequence of steps, hazards and re-arms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from readable_supervisor import Supervisor
from supervised_loop import CAP

from dvf_ig.guidance import WITHHOLDING, Hazard, RearmAnswer, SupervisorState

OK, DEGRADED, FADE, LATCHED = SupervisorState


def drawn_sequence(seed, count):
    """(time, wanted, hazards, re-arm asked) of a rough session: jumps, NaN, flicker, uneven steps."""
    rng = np.random.default_rng(seed)
    t_s, wanted, hazards = 0.0, np.zeros(3), Hazard.NONE
    members = [hazard for hazard in Hazard if hazard is not Hazard.FORCE_CLAMPED]
    smooth = rng.uniform() < 0.5
    for _ in range(count):
        t_s += float(rng.choice([0.0, 0.001, 0.001, 0.001, 0.004, 0.03], p=[0.05, 0.3, 0.3, 0.3, 0.04, 0.01]))
        wanted = wanted + rng.normal(scale=0.002 if smooth else 0.05, size=3)
        if rng.uniform() < 0.002:
            wanted = rng.normal(size=3)
        wanted = wanted * min(1.0, CAP / max(float(np.linalg.norm(wanted)), 1e-9))
        if rng.uniform() < 0.05:
            hazards = Hazard.NONE
        if rng.uniform() < 0.005:
            hazards |= members[int(rng.integers(len(members)))]
        given_n = wanted.copy()
        if rng.uniform() < 0.0005:
            given_n[rng.integers(3)] = rng.choice([np.nan, np.inf])
        yield t_s, given_n if rng.uniform() < 0.7 else 0.1 * given_n, hazards, rng.uniform() < 0.02


def run(seed, count=3000):
    supervisor, rows = Supervisor(), []
    for t_s, wanted, hazards, ask in drawn_sequence(seed, count):
        out = supervisor.step(t_s, wanted, hazards)
        rows.append((t_s, wanted, hazards, out, supervisor.rearm(t_s) if ask else None))
    return rows


def since_when(active, t_s, since):
    return (t_s if since is None else since) if active else None


@pytest.mark.parametrize("seed", range(101, 104))
def test_what_holds_in_any_sequence_of_steps(seed):
    rows = run(seed)
    fading = WITHHOLDING
    previous, previous_s, state, rearmed = np.zeros(3), 0.0, DEGRADED, False
    unsafe_since = broken_since = None
    begun_n = 0.0
    seen = set()
    for t_s, wanted, hazards, out, answer in rows:
        dt, size = t_s - previous_s, float(np.linalg.norm(out.force_n))
        change, before = float(np.linalg.norm(out.force_n - previous)), float(np.linalg.norm(previous))
        wanted_n = float(np.linalg.norm(wanted)) if np.isfinite(wanted).all() else 0.0
        slack = 1 + 1e-9
        assert np.isfinite(out.force_n).all()
        assert size <= CAP * slack
        assert size <= max(wanted_n, before) * slack
        assert 0.0 <= out.scale <= 1.0
        if out.state in (OK, DEGRADED):
            assert change <= 100.0 * dt * slack + 1e-15
        else:
            assert size <= before * slack or out.hazards & Hazard.FORCE_CLAMPED
            begun_n = before if state in (OK, DEGRADED) else begun_n
            allowed = max(begun_n * math.pi / 2 / 0.020, 100.0 if out.clamped else 0) * dt * slack + 1e-12
            if hazards & Hazard.MISSED_DEADLINES:
                assert not out.force_n.any()
            else:
                assert change <= allowed
        if out.state is LATCHED:
            assert not out.force_n.any()
        if state is LATCHED:
            assert out.state is LATCHED or rearmed
        active = out.hazards
        assert hazards & ~active == Hazard.NONE
        unsafe_since = since_when(active & fading, t_s, unsafe_since)
        broken_since = since_when(active & Hazard.NOT_FINITE, t_s, broken_since)
        if unsafe_since is not None and t_s >= unsafe_since + 0.2500001:
            assert not out.force_n.any()
        if broken_since is not None and t_s >= broken_since + 0.0200001:
            assert not out.force_n.any()
        if active & fading:
            assert out.state in (FADE, LATCHED)
            assert out.sentences
        rearmed = answer is RearmAnswer.ACCEPTED
        if rearmed:
            assert wanted_n < 0.2
            assert not active & fading
        seen.add(out.state)
        previous, previous_s, state = out.force_n, t_s, out.state
    assert seen == set(SupervisorState)


@given(st.integers(0, 2**32 - 1))
def test_the_same_steps_give_the_same_bits(seed):
    for (*_, a, _), (*_, b, _) in zip(run(seed, 200), run(seed, 200), strict=True):
        assert np.array_equal(a.force_n, b.force_n)
        for name in ("state", "hazards", "cause", "scale", "clamped"):
            assert getattr(a, name) == getattr(b, name)
