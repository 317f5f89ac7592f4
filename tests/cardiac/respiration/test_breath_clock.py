"""Breathing clock: causal, follows and forecasts real recordings, names what is not an ordinary breath."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from dvf_ig.cardiac.respiration import BreathEvent, BreathState, RelearningClock, learn_scale, track_breathing
from dvf_ig.cardiac.respiration.breath_clock import BreathClock
from dvf_ig.core import FloatArray, InvalidInputError, Respiration
from dvf_ig.io.respiration import read_respiration

T_S = np.arange(0.0, 90.0, 0.04)


def ventilated(t_s: FloatArray, period_s: float = 4.0) -> FloatArray:
    """Fill for a third of the breath, then empty exponentially; 5 to 15 units."""
    x = t_s % period_s
    filling = period_s / 3.0
    return np.asarray(5.0 + 10.0 * np.where(x < filling, x / filling, np.exp(-(x - filling) / 0.5)))


def noisy(values: FloatArray, seed: int = 0) -> Respiration:
    noise = 0.1 * np.random.default_rng(seed).standard_normal(len(values))
    return Respiration(T_S[: len(values)], (values + noise)[:, None], "pressure")


def test_an_ordinary_breath_locks_with_its_rate_and_scale() -> None:
    track = track_breathing(noisy(ventilated(T_S)), T_S[::10])
    settled = T_S[::10] > 30.0
    assert (track.state[settled] == BreathState.LOCKED).all()
    assert track.rate_per_min(30.0, 90.0) == pytest.approx(15.0, abs=0.1)
    assert np.nanmin(track.rho) == pytest.approx(0.0, abs=0.15)
    assert np.nanmax(track.rho) == pytest.approx(1.0, abs=0.2)


def test_a_prefix_gives_the_same_readings() -> None:
    whole, at = noisy(ventilated(T_S)), T_S[::7]
    cut = at[at < 47.0]
    prefix = Respiration(whole.t_s[whole.t_s < 47.0], whole.values[whole.t_s < 47.0], "pressure")
    full, part = track_breathing(whole, at), track_breathing(prefix, cut)
    for name in ("rho", "sigma_rho", "phase", "period_s", "state"):
        np.testing.assert_array_equal(getattr(full, name)[: len(cut)], getattr(part, name))


@pytest.mark.parametrize(
    ("change", "event", "within_s"),
    [
        (lambda t, v: np.where((t > 60) & (t < 64), 5.0 + 1.8 * (v - 5.0), v), BreathEvent.DEEP_BREATH, 1.5),
        (
            lambda t, v: np.where((t > 60) & (t < 75), ventilated(np.array([59.9]))[0], v),
            BreathEvent.PAUSE,
            6.8,
        ),
        (lambda t, v: np.where((t > 60) & (t < 75), 0.0, v), BreathEvent.DISCONNECTION, 0.3),
        (lambda t, v: v + 9 * np.exp(-0.5 * ((t - 62.5) / 0.08) ** 2), BreathEvent.COUGH, 2.6),
        (lambda t, v: np.where(t > 60, ventilated(t, 2.0), v), BreathEvent.CHANGED_RATE, 3.0),
    ],
    ids=["deep breath", "pause", "disconnection", "cough", "changed rate"],
)
def test_what_is_not_ordinary_is_named_in_time(change: object, event: BreathEvent, within_s: float) -> None:
    at = np.arange(50.0, 90.0, 0.1)
    assert callable(change)
    track = track_breathing(noisy(change(T_S, ventilated(T_S))), at)
    assert (track.state[at < 60.0] == BreathState.LOCKED).all()
    soon = (at > 60.0) & (at <= 60.0 + within_s)
    assert (track.state[soon] != BreathState.LOCKED).any()
    assert event in track.event[(at > 60.0) & (at < 66.0)]
    assert track.state[-1] == BreathState.LOCKED


@pytest.mark.parametrize(
    "changed",
    [lambda v: 5.0 + 1.9 * (v - 5.0), lambda v: v - 6.0, lambda v: v + 20.0],
    ids=["deeper", "lower", "higher"],
)
def test_breathing_that_has_changed_for_good_is_learnt_again(changed: object) -> None:
    assert callable(changed)
    t_s = np.arange(0.0, 140.0, 0.04)
    values = np.where(t_s > 60.0, changed(ventilated(t_s)), ventilated(t_s))
    noise = 0.1 * np.random.default_rng(0).standard_normal(len(t_s))
    clock = RelearningClock()
    for k in range(len(t_s)):
        clock.push(t_s[k : k + 1], (values + noise)[k : k + 1, None])
        if t_s[k] < 60.0 + 4.0 * 4.0:
            assert clock.changes == 0
    assert clock.changes == 1
    assert clock.clock.reading(140.0).state is BreathState.LOCKED
    rho = clock.clock.features(np.arange(110.0, 139.0, 0.1))[:, 1]
    assert np.percentile(rho, [5, 99]) == pytest.approx([0.0, 1.0], abs=0.2)
    assert np.isnan(clock.clock.features(np.array([59.0]))).all()


def test_missing_samples_lose_it_and_bad_ones_are_refused() -> None:
    clock = BreathClock()
    samples = noisy(ventilated(T_S))
    clock.push(samples.t_s, samples.values)
    assert clock.reading(T_S[-1] + 0.2).state is BreathState.LOCKED
    assert clock.reading(T_S[-1] + 0.8).state is BreathState.LOST
    with pytest.raises(InvalidInputError, match="came after"):
        clock.push(np.array([3.0]), np.array([[1.0]]))
    with pytest.raises(InvalidInputError, match="not finite"):
        clock.push(np.array([100.0]), np.array([[np.nan]]))


def test_nothing_that_breathes_gives_no_scale() -> None:
    assert learn_scale(np.random.default_rng(1).standard_normal((500, 1))) is None


def test_features_before_now_do_not_change_and_ahead_are_forecast() -> None:
    clock, samples = BreathClock(), noisy(ventilated(T_S))
    half = len(T_S) // 2
    clock.push(samples.t_s[:half], samples.values[:half])
    now = float(T_S[half - 1])
    ahead = clock.features(np.array([now + 0.1, now + 5.0]))
    before = clock.features(np.array([now - 3.0]))
    clock.push(samples.t_s[half:], samples.values[half:])
    np.testing.assert_array_equal(clock.features(np.array([now - 3.0])), before)
    assert ahead[0] == pytest.approx(clock.features(np.array([now + 0.1]))[0], abs=0.1)
    assert np.isnan(ahead[1]).all()


RECORDS = (
    ("wfdb:03700181", None),
    ("wfdb:v102s#RESP", None),
    ("csv:neurokit_bio_resting_5min_100hz.csv", 100.0),
    ("csv:neurokit_bio_resting_8min_100hz.csv", 100.0),
    ("csv:bidmc_01_Signals.csv", None),
)


def reference_rates(recorded: Respiration) -> list[tuple[float, float, float]]:
    """Windows of 32 s with their rate by the crossings of the whole recording, filtered both ways."""
    t_s = np.arange(recorded.t_s[0], recorded.t_s[-1], 0.1)
    band = butter(2, (0.1, 0.7), btype="bandpass", fs=10, output="sos")
    values = sosfiltfilt(band, np.interp(t_s, recorded.t_s, recorded.values[:, 0]))
    rising = t_s[1:][(values[1:] > 0) & (values[:-1] <= 0)]
    out = []
    for start in np.arange(t_s[0] + 16.0, t_s[-1] - 32.0, 16.0):
        inside = rising[(rising >= start) & (rising < start + 32.0)]
        out.append((float(start), float(start + 32.0), 60.0 * (len(inside) - 1) / (inside[-1] - inside[0])))
    return out


def test_the_rate_of_real_recordings_is_right_where_one_is_stated(data_dir: Path) -> None:
    """The spectrum of the whole recording agrees with these crossings in 79 % of the windows only."""
    apart = []
    for name, rate_hz in RECORDS:
        kind, _, file = name.partition(":")
        whole = read_respiration(f"{kind}:{data_dir / 'ecg-resp' / file}", rate_hz)
        every = max(1, round(0.03 * len(whole) / (whole.t_s[-1] - whole.t_s[0])))
        recorded = Respiration(whole.t_s[::every], whole.values[::every], whole.name)
        track = track_breathing(recorded, np.arange(recorded.t_s[0] + 1.0, recorded.t_s[-1], 1.0))
        apart += [track.rate_per_min(a, b) - rate for a, b, rate in reference_rates(recorded)]
    stated = np.isfinite(apart)
    near = np.abs(np.array(apart)[stated]) <= 1.0
    assert stated.mean() >= 0.7, f"a rate in {stated.mean():.1%} of {len(apart)} windows"
    assert near.mean() >= 0.9, f"{near.mean():.1%} of {len(near)} rates"


def test_real_chest_markers_are_forecast_better_than_held(data_dir: Path) -> None:
    better = {0.1: [], 0.3: []}  # type: dict[float, list[float]]
    for path in sorted((data_dir / "external-markers").glob("*.csv"))[::12]:
        recorded = read_respiration(f"marker:{path}", 10.0)
        clock = BreathClock()
        begin = int(np.searchsorted(recorded.t_s, recorded.t_s[0] + 30.0))
        clock.push(recorded.t_s[:begin], recorded.values[:begin])
        missed: dict[float, list[tuple[float, float]]] = {0.1: [], 0.3: []}
        pending: list[tuple[float, float, float, float]] = []
        for t_s, value in zip(recorded.t_s[begin:], recorded.values[begin:], strict=True):
            clock.push(np.array([t_s]), value[None])
            held = clock.reading(t_s).rho
            pending += [(t_s + ahead, ahead, clock.reading(t_s + ahead).rho, held) for ahead in missed]
        for due_s, ahead, forecast, held in pending:
            if due_s <= recorded.t_s[-1]:
                true = clock.features(np.array([due_s]))[0, 1]
                missed[ahead].append((forecast - true, held - true))
        for ahead, errors in missed.items():
            ours, hold = np.sqrt((np.array(errors) ** 2).mean(axis=0))
            better[ahead].append(ours / hold)
    assert np.mean(better[0.1]) < 0.6
    assert np.mean(better[0.3]) < 0.6
