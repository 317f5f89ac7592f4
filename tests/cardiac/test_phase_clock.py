"""The phase clock: never backwards, states that hold, causal, accurate."""

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.cardiac import PhaseClock, RPeak, phase_from_peaks
from dvf_ig.cardiac.phase_clock import LATEST_S
from dvf_ig.cardiac.rr_predictor import PREDICTORS, PredictorName, make_predictor
from dvf_ig.core import FloatArray, InvalidInputError, PhaseState, PhaseTrack

LATENCY_S = 0.12


def known(rr_s: FloatArray | list[float], quality: float = 1.0) -> tuple[RPeak, ...]:
    """R peaks of a series of RR intervals, each known 120 ms later."""
    times = np.concatenate([[0.0], np.cumsum(rr_s)])
    return tuple(RPeak(float(t), float(t) + LATENCY_S, quality) for t in times)


def track(
    rr_s: FloatArray | list[float], *, stop_s: float | None = None, rate_hz: float = 200.0
) -> PhaseTrack:
    end = float(np.sum(rr_s)) if stop_s is None else stop_s
    return phase_from_peaks(known(rr_s), (), np.arange(0.0, end, 1 / rate_hz))


def backward_steps(phi: FloatArray) -> FloatArray:
    """Changes of phase modulo 1 in (-0.5, 0.5] that are negative."""
    step = (np.diff(phi) + 0.5) % 1.0 - 0.5
    return step[step < -1e-9]


def test_steady_rate_is_exact() -> None:
    found = track([0.8] * 30)
    settled = found.t_s > 8.0
    assert found.valid[settled].all()
    truth = (found.t_s / 0.8) % 1.0
    error = (found.phi - truth + 0.5) % 1.0 - 0.5
    assert np.abs(error[settled]).max() < 1e-6
    assert np.allclose(found.rr_s[settled], 0.8)


def test_init_ends_with_the_fifth_beat() -> None:
    found = track([0.8] * 10)
    first_valid = found.t_s[np.flatnonzero(found.valid)[0]]
    assert first_valid == pytest.approx(4 * 0.8 + LATENCY_S, abs=0.01)
    assert (found.state[found.t_s < first_valid - 0.01] == PhaseState.INIT).all()


@settings(max_examples=12)
@given(st.lists(st.floats(0.35, 1.6), min_size=8, max_size=40), st.floats(0.002, 0.2))
def test_phase_never_runs_backwards(rr_s: list[float], step_s: float) -> None:
    clock = PhaseClock()
    peaks = list(known(rr_s))
    readings = []
    # unwrapped phase is what the clock keeps; with steps below half a cycle it can be followed outside
    for now in np.arange(0.0, sum(rr_s) + 2.0, min(step_s, 0.05)):
        while peaks and peaks[0].detected_at_s <= now:
            clock.add(peaks.pop(0))
        readings.append(clock.at(float(now)))
        assert 0.0 <= readings[-1].phi < 1.0
    assert len(backward_steps(np.array([r.phi for r in readings]))) == 0


@settings(max_examples=25)
@given(st.lists(st.floats(0.6, 1.1), min_size=8, max_size=20), st.floats(0.3, 0.95))
def test_prefix_of_the_peaks_gives_the_same_phase(rr_s: list[float], share: float) -> None:
    peaks, stop = known(rr_s), share * sum(rr_s)
    t = np.arange(0.0, stop, 0.01)
    whole = phase_from_peaks(peaks, (), t)
    prefix = phase_from_peaks(tuple(p for p in peaks if p.detected_at_s <= stop), (), t)
    assert np.array_equal(whole.phi, prefix.phi)
    assert np.array_equal(whole.state, prefix.state)


@settings(max_examples=25)
@given(
    st.lists(st.floats(0.35, 2.5), min_size=8, max_size=25),
    st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30),
)
def test_what_the_clock_says_does_not_depend_on_what_was_asked_before(
    rr_s: list[float], shares: list[float]
) -> None:
    peaks, end = known(rr_s), sum(rr_s) + 4.0
    few = np.unique(np.array(shares) * end)
    often = np.union1d(np.arange(0.0, end, 0.001), few)
    one, many = phase_from_peaks(peaks, (), few), phase_from_peaks(peaks, (), often)
    at = np.searchsorted(often, few)
    for name in ("phi", "sigma_phi", "rr_s", "state"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name)[at])


def test_a_deadline_has_its_exact_time() -> None:
    clock = PhaseClock()
    for peak in known([0.8] * 12):
        clock.add(peak)
    forecast = clock.forecast(9.8)
    assert forecast.state is PhaseState.LOCKED
    assert forecast.until_s == pytest.approx(12 * 0.8 + 1.35 * 0.8 + LATENCY_S)
    late = clock.forecast(30.0)
    assert (late.since_s, late.state) == (forecast.until_s, PhaseState.LOST)
    assert forecast.at(30.0).state is PhaseState.LOST, "an old forecast is not valid for longer"


def test_late_r_holds_and_wraps_before() -> None:
    found = track([0.8] * 12 + [0.9] + [0.8] * 4)
    start = 12 * 0.8
    running = (found.t_s > start + 0.82) & (found.t_s < start + 0.9)
    assert (found.phi[running] < 0.15).all(), "past one predicted beat phase wraps"
    held = (found.t_s > start + 0.9 + LATENCY_S) & (found.t_s < start + 0.9 + LATENCY_S + 0.05)
    assert np.ptp(found.phi[held]) < 0.07, "the late R holds phase until time has caught up"
    assert len(backward_steps(found.phi)) == 0


def test_early_r_within_tolerance_is_caught_up_at_a_bounded_rate() -> None:
    found = track([0.8] * 12 + [0.70] + [0.8] * 4, rate_hz=1000.0)
    assert found.valid[found.t_s > 5.0].all(), "12 % early is not yet suspect"
    rate = ((np.diff(found.phi) + 0.5) % 1.0 - 0.5) * 1000.0
    assert rate[found.t_s[1:] > 5.0].max() <= 3.0 / 0.7 + 1e-6


def test_an_early_beat_and_its_pause_are_one_event() -> None:
    found = track([0.8] * 12 + [0.5, 1.1] + [0.8] * 6)
    early, over = 12 * 0.8 + 0.5 + LATENCY_S, 12 * 0.8 + 1.6 + LATENCY_S
    pair = (found.t_s > early + 0.01) & (found.t_s < over - 0.01)
    assert (found.state[pair] == PhaseState.SUSPECT).all()
    assert (found.rr_s[pair] > 0.8).all(), "a pause is expected"
    after = found.t_s > over + 0.01
    assert found.valid[after].all(), "locked again with the first beat after the pause"
    assert np.allclose(found.rr_s[after], 0.8), "the event leaves the prediction as it was"


def test_an_early_r_without_its_pause_needs_one_more_beat() -> None:
    # an artefact: 0.3 s after R, and the next "beat" where sinus rhythm would not put it
    found = track([0.85] * 12 + [0.31, 0.86] + [0.85] * 6)
    known_s = 12 * 0.85 + 0.31 + 0.86 + LATENCY_S
    between = (found.t_s > known_s + 0.01) & (found.t_s < known_s + 0.8)
    assert not found.valid[between].any()
    assert found.valid[-1]


def test_no_r_is_lost_at_1_35_rr_plus_latency() -> None:
    found = track([0.8] * 12, stop_s=14.0)
    last_r = 12 * 0.8
    lost_at = found.t_s[np.flatnonzero(found.state == PhaseState.LOST)[0]]
    assert lost_at == pytest.approx(last_r + 1.35 * 0.8 + LATENCY_S, abs=0.01)


def test_lead_off_is_lost_at_once_and_relocks_after_four_beats() -> None:
    clock = PhaseClock()
    peaks = known([0.8] * 30)
    for peak in peaks[:10]:
        clock.add(peak)
    clock.signal_changed(7.5, on=False)
    assert clock.at(7.51).state == PhaseState.LOST
    clock.signal_changed(7.6, on=True)
    states = []
    for peak in peaks[10:16]:
        clock.add(peak)
        states.append(clock.at(peak.detected_at_s).state)
    assert states[2] == PhaseState.LOST
    assert states[-1] == PhaseState.LOCKED


def test_fibrillation_is_irregular() -> None:
    rr = np.random.default_rng(3).uniform(0.4, 1.1, 60)
    found = track(rr)
    late = found.t_s > 20.0
    assert found.valid[late].mean() < 0.02
    assert (found.state[late] == PhaseState.IRREGULAR).mean() > 0.8


def test_weak_complexes_are_suspect() -> None:
    clock = PhaseClock()
    for peak in known([0.8] * 8):
        clock.add(peak)
    clock.add(RPeak(9 * 0.8, 9 * 0.8 + LATENCY_S, 0.1))
    assert clock.state == PhaseState.SUSPECT


def test_a_lasting_change_of_rate_is_followed() -> None:
    found = track([1.0] * 12 + [0.6] * 24)
    assert found.valid[-1]
    assert found.rr_s[-1] == pytest.approx(0.6, rel=0.02)


def test_correction_within_a_quarter_second_replaces_the_beat() -> None:
    clock = PhaseClock()
    for peak in known([0.8] * 8):
        clock.add(peak)
    clock.add(RPeak(6.4 + 0.16, 6.4 + 0.3, 1.0))
    assert clock.state == PhaseState.LOCKED
    assert clock.at(6.4 + 0.56).phi == pytest.approx(0.5, abs=0.12)


def test_sigma_grows_with_the_beat() -> None:
    rng = np.random.default_rng(0)
    rr = 0.8 + 0.03 * rng.standard_normal(60)
    found = track(rr)
    truth_beat = np.searchsorted(np.cumsum(rr), found.t_s, side="right")
    start = np.concatenate([[0.0], np.cumsum(rr)])[truth_beat]
    truth = (found.t_s - start) / rr[np.minimum(truth_beat, 59)]
    error = (found.phi - truth + 0.5) % 1.0 - 0.5
    late = found.valid & (found.t_s > 10.0)
    ratio = np.sqrt(np.mean((error[late] / found.sigma_phi[late]) ** 2))
    assert 0.5 < ratio < 1.5, "sigma is neither boastful nor timid"


@pytest.mark.parametrize("name", list(PREDICTORS))
def test_predictors_settle_on_a_constant(name: PredictorName) -> None:
    predictor = make_predictor(name)
    assert np.isnan(predictor.predict())
    for _ in range(30):
        predictor.add(0.9)
    assert predictor.predict() == pytest.approx(0.9)


def test_autoregression_beats_the_last_value_on_respiratory_arrhythmia() -> None:
    rr = 0.85 + 0.08 * np.sin(2 * np.pi * np.arange(200) / 4.7)
    misses = {}
    for name in PREDICTORS:
        predictor = make_predictor(name)
        errors = []
        for value in rr:
            errors.append(abs(predictor.predict() - value))
            predictor.add(float(value))
        misses[name] = float(np.mean(errors[60:]))
    assert misses["ar8"] < 0.3 * misses["last"]
    assert misses["ar8"] < 0.3 * misses["ewma"]


def test_refusals() -> None:
    clock = PhaseClock()
    clock.at(1.0)
    with pytest.raises(InvalidInputError, match="in order"):
        clock.at(0.5)
    with pytest.raises(InvalidInputError, match="nan s"):
        clock.at(float("nan"))
    clock.add(RPeak(2.0, 2.1, 1.0))
    with pytest.raises(InvalidInputError, match="in order"):
        clock.add(RPeak(1.5, 2.2, 1.0))
    with pytest.raises(InvalidInputError, match="choose ar8"):
        make_predictor("magic")


NUMBERS = st.one_of(
    st.floats(0.0, 60.0), st.floats(), st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e300, 1e10])
)


@given(calls=st.lists(st.tuples(st.sampled_from(["add", "changed", "at"]), NUMBERS, NUMBERS, NUMBERS)))
def test_any_number_is_refused_or_harms_nothing(calls: list[tuple[str, float, float, float]]) -> None:
    """A time without end, once taken, would make every later one too early; a phase in use is a phase."""
    clock = PhaseClock()
    for beat in range(8):
        clock.add(RPeak(0.8 * beat, 0.8 * beat + 0.1, 1.0))
    for call, first, second, quality in calls:
        with suppress(InvalidInputError):
            if call == "add":
                clock.add(RPeak(first, second, quality))
            elif call == "changed":
                clock.signal_changed(first, quality > 0.5)
            else:
                reading = clock.at(first)
                assert reading.state is not PhaseState.LOCKED or 0.0 <= reading.phi < 1.0
                assert reading.state is not PhaseState.LOCKED or math.isfinite(reading.sigma_phi)
    reading = clock.at(LATEST_S)
    assert reading.state is not PhaseState.LOCKED


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e300])
def test_times_that_are_none_are_refused(wrong: float) -> None:
    clock, same = PhaseClock(), PhaseClock()
    for beat in range(8):
        for one in (clock, same):
            one.add(RPeak(0.8 * beat, 0.8 * beat + 0.1, 1.0))
    for peak in (
        RPeak(wrong, 6.6, 1.0),
        RPeak(6.5, wrong, 1.0),
        RPeak(6.4, 6.5, wrong if wrong < 1e99 else -1.0),
    ):
        with pytest.raises(InvalidInputError):
            clock.add(peak)
    for call in (clock.at, clock.forecast, lambda t_s: clock.signal_changed(t_s, on=False)):
        with pytest.raises(InvalidInputError, match="the phase clock got the time"):
            call(wrong)
    assert clock.at(6.0) == same.at(6.0)
