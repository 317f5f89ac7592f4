"""The synthetic ECG: R waves where the rhythm says, disturbances of the stated size."""

import numpy as np
import pytest
from scipy.signal import welch

from data_synth.ecg import EcgSpec, clean_ecg, synthetic_ecg
from data_synth.rhythm import Beats, RhythmSpec, beat_series

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
    k = int(np.searchsorted(truth.r_peaks_s, 30.0))
    spec = EcgSpec(lead_off_s=((10.0, 12.0),), missed_beats=(k,))
    ecg = synthetic_ecg(truth, 60.0, spec, np.random.default_rng(4))
    off = (ecg.t_s >= 10.0) & (ecg.t_s < 12.0)
    assert (ecg.samples[off] == 0).all()
    mv = clean_ecg(truth, ecg.t_s, spec)[:, 0]
    assert np.abs(mv[np.abs(ecg.t_s - truth.r_peaks_s[k]) < 0.06]).max() < 0.1


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
