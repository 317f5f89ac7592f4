"""Retiming: identity at the model's own rate, monotone, and end-systole where physiology puts it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from dvf_ig.cardiac import frame_period_s, retime, retiming_curve
from dvf_ig.cardiac.retime import systole_share
from dvf_ig.core import InvalidInputError

PHI = np.linspace(0.0, 0.999, 500)


def test_uniform_is_the_paper() -> None:
    assert np.array_equal(retime(PHI, 0.7, 1.0, 0.35, "uniform"), PHI)
    assert frame_period_s(0.8, 20) == pytest.approx(0.04)


@given(st.floats(0.4, 1.6), st.floats(0.2, 0.6))
def test_identity_at_the_models_own_rate(rr_s: float, es: float) -> None:
    # the cubic through knots on a line is that line
    assert np.allclose(retime(PHI, rr_s, rr_s, es, "two-segment"), PHI, atol=1e-12)


@given(st.floats(0.35, 1.8), st.floats(0.4, 1.6), st.floats(0.2, 0.6))
def test_two_segment_rises_within_the_cycle(rr_s: float, own_s: float, es: float) -> None:
    found = retime(PHI, rr_s, own_s, es, "two-segment")
    assert (np.diff(found) > -1e-12).all()
    assert found[0] == 0.0
    assert found[-1] < 1.0
    systole = float(systole_share(rr_s, own_s, es))
    assert float(retime(systole, rr_s, own_s, es, "two-segment")) == pytest.approx(es, abs=1e-12)


@given(st.floats(0.4, 1.5), st.floats(0.5, 1.4), st.floats(0.25, 0.5))
def test_breakpoint_is_scipys_periodic_pchip(rr_s: float, own_s: float, es: float) -> None:
    systole = float(systole_share(rr_s, own_s, es))
    x = np.array([systole - 1, 0, systole, 1, 1 + systole])
    y = np.array([es - 1, 0, es, 1, 1 + es])
    assert np.allclose(retime(PHI, rr_s, own_s, es, "two-segment"), PchipInterpolator(x, y)(PHI), atol=1e-9)


def test_end_systole_at_90_bpm_from_a_cine_at_60() -> None:
    # QS2 = 546 − 2.1 HR ms: 420 ms at 60, 357 ms at 90 beats/min; uniform puts it at 280 ms
    rr, own = 60 / 90, 1.0
    share = float(systole_share(rr, own, 0.420, slope_s_per_bpm=0.0021))
    assert share * rr == pytest.approx(0.357, abs=1e-9)
    assert 0.420 * rr == pytest.approx(0.280)


@given(st.floats(0.4, 1.5), st.floats(0.5, 1.4), st.floats(0.25, 0.5))
def test_the_curve_of_a_beat_is_its_retiming(rr_s: float, own_s: float, es: float) -> None:
    curve = retiming_curve(rr_s, own_s, es, "two-segment")
    np.testing.assert_array_equal(curve.at(PHI), retime(PHI, rr_s, own_s, es, "two-segment"))
    np.testing.assert_allclose(retiming_curve(rr_s, own_s, es).at(PHI), PHI, atol=1e-15)


def test_vectorised_over_rr() -> None:
    rr = np.array([0.6, 0.8, 1.0])
    found = retime(np.full(3, 0.5), rr, 0.9, 0.36, "two-segment")
    for k in range(3):
        assert found[k] == pytest.approx(float(retime(0.5, float(rr[k]), 0.9, 0.36, "two-segment")))


def test_refusals() -> None:
    with pytest.raises(InvalidInputError, match="choose uniform"):
        retime(0.5, 0.8, 0.8, 0.3, "magic")
    with pytest.raises(InvalidInputError, match="above 0"):
        retime(0.5, float("nan"), 0.8, 0.3)
    with pytest.raises(InvalidInputError, match="end-systole"):
        retime(0.5, 0.8, 0.8, 0.0)
    with pytest.raises(InvalidInputError, match="above 0"):
        retiming_curve(float("nan"), 0.8, 0.3)
    with pytest.raises(InvalidInputError, match="choose uniform"):
        retiming_curve(0.8, 0.8, 0.3, "magic")
    with pytest.raises(InvalidInputError, match="at least 1 frame"):
        frame_period_s(0.8, 0)
