"""Beats, and the true clock that turns time into the phase of the pre-operative cycle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from data_synth.heart.clock import HeartClock, two_segment_phase
from data_synth.signals.rhythm import RhythmSpec, beat_series
from dvf_ig.core import InvalidInputError


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_mean_rate_and_variability_are_as_asked() -> None:
    spec = RhythmSpec(respiratory=0.03, mayer=0.0, jitter=0.0)
    rr = np.diff(beat_series(spec, 0.0, 1200.0, rng()).r_peaks_s)
    assert 60.0 / rr.mean() == pytest.approx(72.0, rel=0.005)
    assert rr.std() / rr.mean() == pytest.approx(0.03 / np.sqrt(2), rel=0.05)


def test_beats_cover_the_recording() -> None:
    peaks = beat_series(RhythmSpec(), -3.0, 63.0, rng()).r_peaks_s
    assert peaks[0] <= -3.0
    assert peaks[-1] >= 63.0
    assert (np.diff(peaks) > 0).all()


def test_rate_ramp_is_followed() -> None:
    spec = RhythmSpec(rate_bpm=((0.0, 60.0), (60.0, 120.0)), respiratory=0.0, mayer=0.0, jitter=0.0)
    peaks = beat_series(spec, 0.0, 80.0, rng()).r_peaks_s
    rate = 60.0 / np.diff(peaks)
    assert np.abs(rate - np.interp(peaks[:-1], (0.0, 60.0), (60.0, 120.0))).max() < 1e-9


def test_an_early_beat_is_followed_by_a_full_pause() -> None:
    spec = RhythmSpec(respiratory=0.0, mayer=0.0, jitter=0.0, ectopic_share=0.1)
    beats = beat_series(spec, 0.0, 300.0, rng())
    rr = np.diff(beats.r_peaks_s)
    early = np.flatnonzero(beats.ectopic[1:-1])
    assert len(early) > 10
    np.testing.assert_allclose(rr[early], 0.65 * 60 / 72)
    np.testing.assert_allclose(rr[early] + rr[early + 1], 2 * 60 / 72)


@pytest.mark.parametrize("knots", [((0.0, 10.0),), ((5.0, 60.0), (0.0, 70.0)), ()])
def test_impossible_rates_are_refused(knots: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(InvalidInputError, match="rate"):
        RhythmSpec(rate_bpm=knots)


@given(st.floats(0.5, 1.5), st.floats(0.15, 0.85), st.floats(0.0, 0.999))
def test_the_models_own_rate_maps_to_itself(rr: float, es: float, phi: float) -> None:
    assert abs(float(two_segment_phase(np.array(phi), np.array(rr), rr, es)) - phi) < 1e-12


@given(st.floats(0.25, 2.8), st.floats(0.5, 1.5), st.floats(0.2, 0.6))
def test_phase_rises_through_every_beat(rr: float, model_rr: float, es: float) -> None:
    phi = np.linspace(0.0, 1.0, 400, endpoint=False)
    phase = two_segment_phase(phi, np.full(400, rr), model_rr, es)
    assert phase[0] == 0.0
    assert (np.diff(phase) > 0).all()
    assert phase[-1] < 1.0


def test_map_is_the_periodic_monotone_cubic_through_end_systole() -> None:
    rr, model_rr, es = 0.6, 0.9, 0.36
    x = (es * model_rr + 0.002 * (60 / model_rr - 60 / rr)) / rr
    knots = np.array([x - 1, 0.0, x, 1.0, 1 + x, 2.0])
    values = np.array([es - 1, 0.0, es, 1.0, 1 + es, 2.0])
    expected = PchipInterpolator(knots, values)
    phi = np.linspace(0.0, 0.999, 500)
    got = two_segment_phase(phi, np.full(500, rr), model_rr, es)
    np.testing.assert_allclose(got, expected(phi), atol=1e-12)


def test_systole_shortens_by_two_milliseconds_per_beat_a_minute() -> None:
    model_rr, es = 1.0, 0.36
    rr = 60.0 / 90.0
    end_systole_s = 0.36 - 0.002 * 30
    phase = two_segment_phase(np.array(end_systole_s / rr), np.array(rr), model_rr, es)
    assert float(phase) == pytest.approx(es, abs=1e-12)


def test_clock_is_continuous_and_extends_beyond_the_beats() -> None:
    peaks = beat_series(RhythmSpec(), 0.0, 20.0, rng(3)).r_peaks_s
    clock = HeartClock(peaks, 0.86, 0.36)
    t = np.arange(-4.0, 26.0, 1e-3)
    phase = clock.model_phase(t)
    step = np.diff(np.unwrap(2 * np.pi * phase)) / (2 * np.pi)
    assert step.min() > 0
    assert step.max() < 3e-3
    np.testing.assert_allclose(clock.phi(peaks), 0.0, atol=1e-9)
    np.testing.assert_allclose(clock.phi(peaks[:-1] + 0.25 * np.diff(peaks)), 0.25, atol=1e-9)


def test_clock_refuses_too_few_or_repeated_beats() -> None:
    with pytest.raises(InvalidInputError, match="at least 2"):
        HeartClock(np.array([1.0]), 0.9, 0.36)
    with pytest.raises(InvalidInputError, match="increase"):
        HeartClock(np.array([1.0, 1.0, 2.0]), 0.9, 0.36)
