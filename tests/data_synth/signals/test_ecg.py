"""The synthetic ECG: R waves where the rhythm says, disturbances of the stated size."""

import numpy as np
import pytest
from scipy.signal import welch

from data_synth.signals.ecg import EcgSpec, clean_ecg, synthetic_ecg
from data_synth.signals.rhythm import Beats, RhythmSpec, beat_series
from dvf_ig.core import InvalidInputError

QUIET = EcgSpec(baseline_mv=0.0, emg_mv=1e-9, mains_mv=0.0)


def beats(rate: float = 72.0, ectopic: float = 0.0) -> Beats:
    spec = RhythmSpec(rate_bpm=((0.0, rate),), ectopic_share=ectopic)
    return beat_series(spec, -3.0, 63.0, np.random.default_rng(1))


@pytest.mark.parametrize("rate", [45.0, 72.0, 150.0])
@pytest.mark.parametrize("lead", [0, 1])
def test_the_r_wave_peaks_at_the_true_time(rate: float, lead: int) -> None:
    truth = beats(rate)
    t = np.arange(0, 60_000) / 1000.0
    mv = clean_ecg(truth, t, EcgSpec())[:, lead]
    for r_s in truth.r_peaks_s[(truth.r_peaks_s > 0.2) & (truth.r_peaks_s < 59.8)]:
        near = np.flatnonzero(np.abs(t - r_s) < 0.08)
        assert abs(t[near[mv[near].argmax()]] - r_s) < 0.002


def test_sampling_leads_and_length() -> None:
    ecg = synthetic_ecg(beats(), 60.0, EcgSpec(), np.random.default_rng(2))
    assert ecg.samples.shape == (30_000, 2)
    assert ecg.rate_hz == 500.0
    assert ecg.start_s == 0.0
    assert ecg.leads == ("II", "V5")
    assert synthetic_ecg(beats(), 10.0, EcgSpec(leads=1), np.random.default_rng(2)).leads == ("II",)


def test_disturbances_have_the_stated_power() -> None:
    spec = EcgSpec(emg_mv=0.05, mains_mv=0.08, baseline_mv=0.1, resolution_mv=1e-6)
    empty = Beats(np.array([-200.0, -199.0]), np.zeros(2, dtype=np.bool_))
    mv = synthetic_ecg(empty, 120.0, spec, np.random.default_rng(3)).samples[:, 0]
    frequency, density = welch(mv, 500.0, nperseg=8192)
    step = frequency[1]
    mains = density[np.abs(frequency - 50) < 0.4].sum() * step
    slow = density[(frequency < 1)].sum() * step
    assert np.sqrt(2 * mains) == pytest.approx(0.08, rel=0.1)
    assert np.sqrt(slow) == pytest.approx(0.1, rel=0.3)
    middle = density[(frequency > 60) & (frequency < 140)].mean()
    assert np.sqrt(middle * 180) == pytest.approx(0.05, rel=0.15)


def test_lead_off_is_flat_and_a_missed_beat_leaves_no_trace() -> None:
    truth = beats()
    inside = truth.r_peaks_s[truth.r_peaks_s >= 0]
    spec = EcgSpec(lead_off_s=((10.0, 12.0),), missed_beats=(30,))
    ecg = synthetic_ecg(truth, 60.0, spec, np.random.default_rng(4))
    off = (ecg.t_s >= 10.0) & (ecg.t_s < 12.0)
    assert (ecg.samples[off] == 0).all()
    mv = clean_ecg(truth, ecg.t_s, spec)[:, 0]
    peaks = [np.abs(mv[np.abs(ecg.t_s - r_s) < 0.06]).max() for r_s in inside[29:32]]
    assert peaks[1] < 0.1
    assert min(peaks[0], peaks[2]) > 0.8


def test_noise_bursts_have_their_power_and_change_nothing_else() -> None:
    spec = EcgSpec(noise_bursts_s=((5.0, 25.0),), burst_mv=0.5)
    quiet = synthetic_ecg(beats(), 40.0, EcgSpec(), np.random.default_rng(6))
    noisy = synthetic_ecg(beats(), 40.0, spec, np.random.default_rng(6))
    burst = (quiet.t_s >= 5.0) & (quiet.t_s < 25.0)
    added = noisy.samples - quiet.samples
    assert (added[~burst] == 0).all()
    # 20 s of a 180 Hz band: 7200 independent values, so the RMS is good to about 1 %
    np.testing.assert_allclose(added[burst].std(axis=0), 0.5, rtol=0.04)
    assert abs(np.atleast_2d(np.corrcoef(added[burst].T))[0, 1]) < 0.06


@pytest.mark.parametrize(
    "changes",
    [{"leads": 3}, {"lead_off_s": ((3.0, 2.0),)}, {"noise_bursts_s": ((3.0, 3.0),)}, {"burst_mv": -1.0}],
)
def test_impossible_disturbances_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError):
        EcgSpec(**changes)


def test_early_beats_are_broad() -> None:
    truth = beats(ectopic=0.15)
    t = np.arange(0, 30_000) / 500.0
    mv = clean_ecg(truth, t, QUIET)[:, 0]

    def width_s(r_s: float) -> float:
        near = np.abs(t - r_s) < 0.06
        return float((mv[near] > 0.5 * mv[near].max()).sum() / 500.0)

    inside = (truth.r_peaks_s > 1) & (truth.r_peaks_s < 59)
    broad = [width_s(r) for r in truth.r_peaks_s[inside & truth.ectopic]]
    narrow = [width_s(r) for r in truth.r_peaks_s[inside & ~truth.ectopic]]
    assert min(broad) > 1.5 * max(narrow)


def test_same_seed_same_samples() -> None:
    first = synthetic_ecg(beats(), 20.0, EcgSpec(), np.random.default_rng(5))
    second = synthetic_ecg(beats(), 20.0, EcgSpec(), np.random.default_rng(5))
    assert np.array_equal(first.samples, second.samples)
