"""From samples to phase and its summary."""

import numpy as np
import pytest

from dvf_ig.cardiac import summarise_gating, track_phase
from dvf_ig.core import InvalidInputError, PhaseState, Signal


def spikes(rr_s: float, rate_hz: float, duration_s: float) -> Signal:
    """Steady narrow complexes, one lead."""
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    x = np.exp(-0.5 * (((t + 0.5 * rr_s) % rr_s - 0.5 * rr_s) / 0.012) ** 2)
    x += 0.01 * np.random.default_rng(0).standard_normal(len(t))
    return Signal(x[:, None], rate_hz, 0.0, ("I",))


def test_a_steady_minute_at_1_khz_is_followed() -> None:
    signal = spikes(0.8, 1000.0, 60.0)
    times = np.arange(0.0, 60.0, 0.001)
    tracking = track_phase(signal, times)
    track = tracking.track
    truth = (times / 0.8) % 1.0
    error = (track.phi - truth + 0.5) % 1.0 - 0.5
    assert track.valid[times > 8.0].all()
    assert np.abs(error[times > 8.0]).max() < 0.01
    summary = summarise_gating(tracking.peaks, track)
    assert summary.rate_bpm == pytest.approx(75.0, abs=0.5)
    assert len(summary.invalid_segments_s) == 1


def test_phase_of_a_prefix_is_the_prefix_of_phase() -> None:
    signal = spikes(0.7, 250.0, 25.0)
    whole = track_phase(signal, np.arange(0.0, 15.0, 0.01)).track
    prefix = track_phase(signal.between(0.0, 15.0), np.arange(0.0, 15.0, 0.01)).track
    assert np.array_equal(whole.phi, prefix.phi)
    assert np.array_equal(whole.state, prefix.state)


def test_an_ecg_that_goes_flat_is_lost() -> None:
    signal = spikes(0.8, 500.0, 20.0)
    samples = signal.samples.copy()
    samples[6000:] = samples[6000]
    track = track_phase(Signal(samples, 500.0, 0.0, ("I",)), np.arange(0.0, 20.0, 0.01)).track
    assert track.valid[(track.t_s > 9) & (track.t_s < 12)].all()
    assert (track.state[track.t_s > 12.25] == PhaseState.LOST).all()


@pytest.mark.parametrize("bpm", [40, 60, 100])
@pytest.mark.parametrize("step_mv", [1e-5, 0.05, 0.25])
def test_a_lead_may_rest_between_beats(bpm: int, step_mv: float) -> None:
    """A clean ECG, or one in coarse steps, keeps one value for up to a second between beats."""
    t = np.arange(20 * 250) / 250
    beat = (t + 0.3) % (60 / bpm) - 0.3
    mv = np.exp(-0.5 * (beat / 0.012) ** 2) - 0.2 * np.exp(-0.5 * ((beat - 0.03) / 0.01) ** 2)
    signal = Signal((np.round(mv / step_mv) * step_mv)[:, None], 250.0, 0.0, ("II",))
    tracking = track_phase(signal, np.arange(0.0, 20.0, 0.01))
    summary = summarise_gating(tracking.peaks, tracking.track, tracking.lead_changes)
    assert summary.invalid_reasons == ("learning the rhythm",)
    assert summary.invalid_segments_s[0, 1] < 6 * 60 / bpm


@pytest.mark.parametrize(
    ("value", "reason"), [(0.003, "lead off (flat line)"), (5.0, "saturation"), (np.nan, "samples missing")]
)
def test_reasons_of_invalid_segments(value: float, reason: str) -> None:
    """An unplugged lead is off after 0.2 s, noisy or clean, and the reason says how."""
    clean = np.round(spikes(0.8, 250.0, 20.0).samples, 1)
    for samples in (spikes(0.8, 250.0, 20.0).samples.copy(), clean + 0.003 * (value == 5.0)):
        samples[2600:2900] = value
        tracking = track_phase(Signal(samples, 250.0, 0.0, ("I",)), np.arange(0.0, 20.0, 0.01))
        summary = summarise_gating(tracking.peaks, tracking.track, tracking.lead_changes)
        first, second = summary.invalid_reasons
        assert (first, reason in second.split(", ")) == ("learning the rhythm", True)
        assert 10.4 <= summary.invalid_segments_s[1, 0] < 10.65


def test_reasons_of_beats_that_do_not_come_or_come_early() -> None:
    signal = spikes(0.8, 250.0, 30.0)
    samples = signal.samples.copy()
    samples[2500:3300] = 0.01 * np.random.default_rng(1).standard_normal((800, 1))
    tracking = track_phase(Signal(samples, 250.0, 0.0, ("I",)), np.arange(0.0, 30.0, 0.01))
    summary = summarise_gating(tracking.peaks, tracking.track, tracking.lead_changes)
    assert "no R peak found" in summary.invalid_reasons[1].split(", ")


def test_no_beats_is_said() -> None:
    flat = Signal(np.zeros((3000, 1)), 500.0, 0.0, ("I",))
    tracking = track_phase(flat, np.arange(0.0, 6.0, 0.01))
    with pytest.raises(InvalidInputError, match=r"0 R peaks in 6\.0 s"):
        summarise_gating(tracking.peaks, tracking.track)
