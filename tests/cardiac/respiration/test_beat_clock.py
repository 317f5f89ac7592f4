"""Breathing clock of beats: causal, by the lead that shows the breath, silent where the breath is another."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from dvf_ig.cardiac import RPeak, detect_r_peaks
from dvf_ig.cardiac.respiration import (
    BeatClock,
    BreathState,
    QrsGain,
    beat_values,
    breath_rates,
    breathing_in_beats,
)
from dvf_ig.core import FloatArray, Signal
from dvf_ig.io import read_beat_source
from dvf_ig.io.respiration import read_respiration

PERIOD_S = 4.3
BEATS_S = np.cumsum(0.83 + 0.02 * np.random.default_rng(1).standard_normal(80))
BEGUN = 25


def volume(t_s: FloatArray) -> FloatArray:
    """Lung that rests for half of each breath."""
    return np.asarray(np.maximum(0.0, np.sin(2.0 * np.pi * t_s / PERIOD_S)) ** 2)


def values_of(t_s: FloatArray, noise: float = 0.005) -> FloatArray:
    """Two leads whose axis the breath turns: one complex grows as the other shrinks; and RR."""
    rng, moved = np.random.default_rng(2), 0.05 * volume(t_s)
    leads = np.stack([1.0 - moved, 1.0 + moved], axis=1) + noise * rng.standard_normal((len(t_s), 2))
    return np.column_stack([leads, 0.83 + 0.02 * rng.standard_normal(len(t_s))])


def begun(t_s: FloatArray, values: FloatArray) -> BeatClock:
    found = breathing_in_beats(t_s[:BEGUN], values[:BEGUN])
    assert found is not None
    assert found.fitted.period_s == pytest.approx(PERIOD_S, abs=0.2)
    return BeatClock(t_s[:BEGUN], values[:BEGUN], found)


def test_the_breath_between_and_after_beats_is_that_of_the_lung() -> None:
    values = values_of(BEATS_S)
    clock, apart = begun(BEATS_S, values), []
    for t_s, value in zip(BEATS_S[BEGUN:], values[BEGUN:], strict=True):
        clock.add(t_s, value)
        now_s = t_s + np.array([0.2, 0.5, 0.8])
        assert clock.reading(t_s + 0.5).state is BreathState.LOCKED
        apart += (clock.features(now_s)[:, 1] - volume(now_s)).tolist()
    assert np.std(apart) < 0.12
    assert len(clock.onsets_s) == 7
    assert np.diff(clock.onsets_s) == pytest.approx(PERIOD_S, abs=0.5)
    assert clock.reading(BEATS_S[-1] + 3.0).state is BreathState.LOST


def test_what_is_known_depends_on_no_later_beat() -> None:
    values = values_of(BEATS_S)
    clock, other = begun(BEATS_S, values), begun(BEATS_S, values)
    for t_s, value in zip(BEATS_S[BEGUN:60], values[BEGUN:60], strict=True):
        clock.add(t_s, value)
        other.add(t_s, value)
    settled_s = np.arange(BEATS_S[30], BEATS_S[59] - 3.5, 0.2)
    before, now = clock.features(settled_s), clock.reading(BEATS_S[59] + 0.3)
    assert now == other.reading(BEATS_S[59] + 0.3)
    for t_s, value in zip(BEATS_S[60:], values[60:], strict=True):
        clock.add(t_s, value)
    np.testing.assert_array_equal(clock.features(settled_s), before)


def test_a_breath_that_does_not_come_is_noticed_at_the_next_beat() -> None:
    stop_s = 12.0 * PERIOD_S
    still = np.where(stop_s > BEATS_S, BEATS_S, stop_s)  # at rest from then on
    values = values_of(still)
    clock = begun(BEATS_S, values)
    states = {}
    for t_s, value in zip(BEATS_S[BEGUN:], values[BEGUN:], strict=True):
        clock.add(t_s, value)
        states[t_s] = clock.reading(t_s + 0.1).state
    first_s = min(t_s for t_s, state in states.items() if state is BreathState.IRREGULAR)
    assert stop_s < first_s < stop_s + 0.5 * PERIOD_S
    assert all(state is BreathState.IRREGULAR for t_s, state in states.items() if t_s >= first_s)
    assert not clock.tells(np.array([BEATS_S[-1]]))[0]


def test_an_early_beat_of_another_origin_is_left_out() -> None:
    values = values_of(BEATS_S)
    values[40] = (2.0, 0.4, 0.5)
    clock = begun(BEATS_S, values)
    for t_s, value in zip(BEATS_S[BEGUN:50], values[BEGUN:50], strict=True):
        clock.add(t_s, value)
        assert clock.reading(t_s + 0.3).state is BreathState.LOCKED


def test_beats_without_breathing_show_none() -> None:
    rng = np.random.default_rng(5)
    flat = np.column_stack([np.ones(45), 1.0 + 0.01 * rng.standard_normal(45)])
    assert breathing_in_beats(BEATS_S[:45], flat) is None
    assert breathing_in_beats(BEATS_S[:45], np.ones((45, 2))) is None
    assert breathing_in_beats(BEATS_S[:5], values_of(BEATS_S[:5])) is None


def test_the_gain_of_a_beat_needs_its_samples_and_no_later_ones() -> None:
    t_s = np.arange(0.0, 12.0, 0.004)
    peaks = np.arange(0.8, 11.5, 0.8)
    sizes = np.interp(t_s, peaks, 1.0 + 0.1 * (np.arange(len(peaks)) % 3 == 2))
    wave = sizes * np.exp(-0.5 * ((t_s[:, None] - peaks) / 0.012) ** 2).sum(axis=1)
    ecg = Signal(np.stack([wave, -2.0 * wave], axis=1), 250.0, 0.0, ("I", "II"))
    found = [RPeak(float(peak), float(peak) + 0.1, 1.0) for peak in peaks]
    _, whole = beat_values(ecg, found)
    _, prefix = beat_values(Signal(ecg.samples[: round(6.5 * 250)], 250.0, 0.0, ("I", "II")), found[:7])
    np.testing.assert_array_equal(prefix, whole[:7])
    third = (np.arange(len(peaks)) % 3 == 2)[5:, None].repeat(2, 1)
    assert whole[5:, :2] == pytest.approx(1.0 + 0.1 * third, abs=0.005)
    ahead = QrsGain(250.0)  # all samples come before the first beat is taken
    for begin in range(0, len(t_s), 50):
        ahead.push(ecg.samples[begin : begin + 50], begin / 250.0)
    for k, peak in enumerate(found):
        ahead.forget(peak.detected_at_s)
        np.testing.assert_array_equal(ahead.gains(peak.t_s, peak.detected_at_s), whole[k, :2])
    assert np.isnan(QrsGain(250.0).gains(1.0, 1.1)).all()
    assert np.isnan(beat_values(ecg, [RPeak(0.8, 0.83, 1.0)])[1]).all()


@pytest.mark.parametrize(
    ("record", "rate_hz", "least"),
    [("wfdb:03700181", None, 0.85), ("csv:neurokit_bio_resting_8min_100hz.csv", 100.0, 0.7)],
)
def test_the_rate_of_breathing_in_real_ecgs(
    data_dir: Path, record: str, rate_hz: float | None, least: float
) -> None:
    """Against crossings of the recorded breath, of which the spectrum gives another rate in a tenth."""
    path = record.replace(":", f":{data_dir / 'ecg-resp'}/")
    signal = read_beat_source(path, rate_hz=rate_hz)
    assert isinstance(signal, Signal)
    recorded = read_respiration(path, rate_hz)
    t_s, values = beat_values(signal, detect_r_peaks(signal))
    known = np.isfinite(values).all(axis=1)
    rates = breath_rates(t_s, values)
    even_s = np.arange(recorded.t_s[0], recorded.t_s[-1], 0.1)
    band = butter(2, (0.1, 0.7), btype="bandpass", fs=10, output="sos")
    breath = sosfiltfilt(band, np.interp(even_s, recorded.t_s, recorded.values[:, 0]))
    rising = even_s[1:][(breath[1:] > 0) & (breath[:-1] <= 0)]
    right = []
    for rate, begin_s in zip(rates, t_s[known][0] + 16.0 * np.arange(len(rates)), strict=True):
        inside = rising[(rising >= begin_s) & (rising < begin_s + 32.0)]
        right.append(abs(rate - 60.0 * (len(inside) - 1) / (inside[-1] - inside[0])) <= 1.0)
    assert np.mean(right) >= least
