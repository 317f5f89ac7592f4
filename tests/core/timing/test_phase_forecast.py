"""Forecast of phase: a pure function of time that waits, catches up, and ends before a beat is overdue."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError, PhaseForecast, PhaseState

LOCKED = PhaseForecast(
    since_s=10.0,
    until_s=11.2,
    state=PhaseState.LOCKED,
    state_after=PhaseState.LOST,
    phi=0.1,
    r_s=9.88,
    cycles=0.0,
    rr_s=0.8,
    spread=0.05,
    catch_up=3.0,
    r_timing_s=0.004,
)


def test_phase_catches_up_then_runs_with_the_heart() -> None:
    # 0.05 of a cycle behind, closed at 2/0.8 cycles a second
    assert LOCKED.at(10.0)[:2] == pytest.approx((0.1, np.sqrt(0.0075**2 + 0.005**2 + 0.05**2)))
    assert LOCKED.at(10.01).phi == pytest.approx(0.1 + 3.0 * 0.01 / 0.8)
    assert LOCKED.at(10.01).rate_hz == pytest.approx(3.0 / 0.8)
    assert LOCKED.at(10.5).phi == pytest.approx(0.62 / 0.8)
    assert LOCKED.at(10.5).rate_hz == pytest.approx(1.0 / 0.8)
    assert LOCKED.at(10.5).sigma_phi == pytest.approx(np.hypot(0.05 * 0.62 / 0.8, 0.004 / 0.8))


def test_phase_waits_for_a_late_beat() -> None:
    ahead = replace(LOCKED, phi=0.3)
    assert ahead.at(10.1)[0] == 0.3
    assert ahead.at(10.1).rate_hz == 0.0
    assert ahead.at(10.3).phi == pytest.approx(0.42 / 0.8)


def test_phase_wraps_while_no_beat_comes() -> None:
    assert LOCKED.at(9.88 + 0.8 + 0.08).phi == pytest.approx(0.1)
    assert LOCKED.at(9.88 + 0.8 + 0.08).state is PhaseState.LOCKED


def test_it_ends_when_a_beat_is_overdue_and_says_nothing_of_the_past() -> None:
    assert LOCKED.at(11.2).state is PhaseState.LOCKED
    assert LOCKED.at(np.nextafter(11.2, 12.0)).state is PhaseState.LOST
    before = LOCKED.at(9.999)
    assert before.state is PhaseState.INIT
    assert np.isnan([before.phi, before.sigma_phi]).all()
    nothing = LOCKED.at_many(np.array([np.nan, np.inf, -np.inf]))
    assert (nothing.state != PhaseState.LOCKED).all()


def test_before_the_first_beat_nothing_is_known() -> None:
    found = PhaseForecast.unknown().at(3.0)
    assert found.state is PhaseState.INIT
    assert (found.phi, found.rate_hz) == (0.0, 0.0)
    assert np.isnan([found.rr_s, found.sigma_phi]).all()


@given(st.lists(st.floats(10.0, 12.0), min_size=1, max_size=8), st.floats(0.0, 0.99), st.floats(-1.0, 2.0))
def test_a_time_has_one_answer_and_phase_does_not_run_backwards(
    times: list[float], phi: float, cycles: float
) -> None:
    forecast = replace(LOCKED, phi=phi, cycles=cycles)
    many = forecast.at_many(np.array(times))
    for k, t_s in enumerate(times):
        assert tuple(column[k] for column in many) == tuple(forecast.at(t_s))
    rise = np.diff(forecast.unwrapped(np.sort(times)))
    assert (rise >= 0).all()
    assert (rise <= 3.0 / 0.8 * np.diff(np.sort(times)) + 1e-12).all()


def test_the_rate_is_that_of_phase() -> None:
    t = np.linspace(10.001, 11.9, 400)
    slope = (LOCKED.unwrapped(t + 1e-6) - LOCKED.unwrapped(t - 1e-6)) / 2e-6
    np.testing.assert_allclose(LOCKED.at_many(t).rate_hz, slope, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"phi": 1.0}, "phase in"),
        ({"until_s": 9.0}, "not before the beginning"),
        ({"state_after": PhaseState.LOCKED}, "never LOCKED after"),
        ({"rr_s": float("nan")}, "needed above 0"),
    ],
)
def test_refusals(change: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        replace(LOCKED, **change)


@given(
    t_s=st.one_of(st.floats(), st.sampled_from([np.inf, -np.inf, np.nan, 1e300, -1e300])),
    rr_s=st.sampled_from([0.8, 1e-300, 1e300, np.nan, 0.0, np.inf]),
    until_s=st.sampled_from([11.2, np.inf]),
)
def test_a_phase_in_use_is_a_phase_at_any_time(t_s: float, rr_s: float, until_s: float) -> None:
    """Never LOCKED with a phase or an uncertainty that is none, and no warning on the way."""
    state = PhaseState.LOCKED if 0.0 < rr_s < np.inf else PhaseState.SUSPECT
    reading = replace(LOCKED, rr_s=rr_s, until_s=until_s, state=state).at(t_s)
    if reading.state is PhaseState.LOCKED:
        assert 0.0 <= reading.phi < 1.0
        assert np.isfinite([reading.sigma_phi, reading.rate_hz]).all()
    if not np.isfinite(t_s):
        assert reading.state is not PhaseState.LOCKED


@pytest.mark.parametrize("t_s", [np.inf, -np.inf, np.nan])
def test_times_that_are_none_are_not_known(t_s: float) -> None:
    reading = replace(LOCKED, until_s=np.inf).at(t_s)
    assert reading.state is PhaseState.INIT
    assert np.isnan([reading.phi, reading.sigma_phi]).all()
    assert reading.rate_hz == 0.0


@pytest.mark.parametrize(
    "changes", [{"rr_s": np.inf}, {"r_s": np.nan}, {"r_s": np.inf}, {"cycles": np.inf}, {"since_s": -np.inf}]
)
def test_a_locked_forecast_of_numbers_that_are_none_is_refused(changes: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError, match="LOCKED"):
        replace(LOCKED, **changes)
