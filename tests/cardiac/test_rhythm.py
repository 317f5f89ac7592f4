"""Irregular beats: learnt as patterns where there is one, refused where there is none."""

from collections.abc import Callable

import numpy as np
import pytest

from dvf_ig.cardiac import RPeak, phase_from_peaks
from dvf_ig.cardiac.beat_pattern import BeatKind, BeatPattern
from dvf_ig.cardiac.rhythm import Rhythm
from dvf_ig.core import BoolArray, FloatArray, PhaseState


def with_ectopy(count: int, seed: int, early: Callable[[int, float], bool]) -> FloatArray:
    """RR intervals with respiratory arrhythmia; `early(k, u)` puts an early beat and a full pause there."""
    rng = np.random.default_rng(seed)
    rr, out = 0.85 * (1 + 0.03 * np.sin(np.arange(count) * 1.34) + 0.02 * rng.standard_normal(count)), []
    for k in range(count):
        if early(k, float(rng.uniform())):
            out += [0.62 * rr[k], 1.38 * rr[k]]
        else:
            out.append(rr[k])
    return np.array(out)


def errors(rr_s: FloatArray) -> tuple[FloatArray, BoolArray, FloatArray]:
    """|Phase error|, valid, sigma after the first 20 s, each R known 120 ms late."""
    beats = np.concatenate([[0.0], np.cumsum(rr_s)])
    peaks = tuple(RPeak(float(t), float(t) + 0.12, 1.0) for t in beats)
    t = np.arange(20.0, beats[-1] - 0.01, 0.05)
    track = phase_from_peaks(peaks, (), t)
    k = np.searchsorted(beats, t, side="right") - 1
    error = track.phi - (t - beats[k]) / (beats[k + 1] - beats[k])
    return np.abs((error + 0.5) % 1.0 - 0.5), track.valid, track.sigma_phi


def test_trigeminy_is_forecast_once_seen() -> None:
    pattern = BeatPattern()
    for _ in range(12):
        for kind in (BeatKind.EARLY, BeatKind.NORMAL, BeatKind.NORMAL):
            pattern.add(kind)
    # two normal beats since the last early one: the next is due
    assert pattern.probabilities()[BeatKind.EARLY] > 0.85
    pattern.add(BeatKind.EARLY)
    assert pattern.probabilities()[BeatKind.EARLY] < 0.05
    assert pattern.probabilities().sum() == pytest.approx(1.0)


def test_random_early_beats_stay_uncertain() -> None:
    pattern, rng = BeatPattern(), np.random.default_rng(3)
    probabilities = []
    for k in range(2000):
        if k > 500:
            probabilities.append(pattern.probabilities()[BeatKind.EARLY])
        pattern.add(BeatKind.EARLY if rng.uniform() < 0.2 else BeatKind.NORMAL)
    assert np.mean(probabilities) == pytest.approx(0.2, abs=0.03)
    # rare contexts have about 15 observations: standard error 0.1, so that 0.5 is three of them away
    assert np.mean(np.array(probabilities) > 0.5) < 0.05, "an early beat is hardly ever called the likely one"


def test_an_early_pair_does_not_move_the_normal_interval() -> None:
    rhythm = Rhythm()
    for _ in range(20):
        rhythm.add(0.8)
    assert rhythm.add(0.5) == BeatKind.EARLY
    assert rhythm.forecast.ectopic
    assert rhythm.forecast.rr_s > 0.9
    assert rhythm.add(1.1) == BeatKind.NORMAL
    assert rhythm.forecast.normal_s == pytest.approx(0.8)
    assert not rhythm.forecast.unreliable


def test_isolated_early_beats_cost_little_and_stay_within_two_sigma() -> None:
    error, valid, sigma = errors(with_ectopy(800, 101, lambda k, u: u < 0.02))
    assert valid.mean() > 0.85
    assert np.percentile(error[valid], 95) < 0.08
    assert (error[valid] < 2 * sigma[valid]).mean() > 0.93


def test_trigeminy_is_followed_but_not_through_the_early_beat() -> None:
    rr = with_ectopy(300, 102, lambda k, u: k % 2 == 1)
    error, valid, _ = errors(rr)
    # the interval that an early beat begins lasts 1.38 of 3.0, and phase is never valid in it
    assert 0.4 < valid.mean() < 1.62 / 3.0 + 0.02
    assert np.percentile(error[valid], 95) < 0.15


@pytest.mark.parametrize("share", [0.2, 0.35])
def test_frequent_random_early_beats_are_refused(share: float) -> None:
    _, valid, _ = errors(with_ectopy(800, 103, lambda k, u: u < share))
    assert valid.mean() < 0.12


@pytest.mark.parametrize("spread", [0.15, 0.2, 0.25])
def test_fibrillation_is_refused(spread: float) -> None:
    rng = np.random.default_rng(104)
    _, valid, _ = errors(np.maximum(0.72 * (1 + spread * rng.standard_normal(600)), 0.33))
    assert valid.mean() < 0.02


def test_a_pattern_that_breaks_is_suspect_within_the_beat() -> None:
    rr = with_ectopy(60, 105, lambda k, u: k % 2 == 1)
    normal_after = np.concatenate([rr[:-2] if len(rr) % 3 else rr, [0.85] * 6])
    beats = np.concatenate([[0.0], np.cumsum(normal_after)])
    peaks = tuple(RPeak(float(t), float(t) + 0.12, 1.0) for t in beats)
    t = np.arange(0.0, beats[-1], 0.01)
    track = phase_from_peaks(peaks, (), t)
    tail = (t > beats[-6]) & (t < beats[-4])
    assert (track.state[tail] == PhaseState.SUSPECT).any()
    assert (np.diff(np.unwrap(2 * np.pi * track.phi)) > -1e-9).all(), "phase never runs backwards"
