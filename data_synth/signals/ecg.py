"""Synthetic ECG: a sum of Gaussian waves tied to each R peak, with the disturbances of an operating room.

Source: McSharry, Clifford, Tarassenko, Smith, IEEE TBME 50:289 (2003).
Differs from source: the waves of the dynamical model are evaluated in closed form, so that the R peak stays
at the rhythm's beat; QRS has a fixed duration in seconds, and the T wave follows RR^0.2, as in real
records, rather than RR^0.5.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from dvf_ig.core import FloatArray, InvalidInputError, Signal

from .rhythm import Beats

LEADS = ("II", "V5")

_WAVES_S = np.array([-0.165, -0.028, 0.0, 0.028, 0.215, 0.265])
"""Centres relative to the R peak at RR = 1 s: P, Q, R, S, and a T wave in two halves."""
_WIDTHS_S = np.array([0.022, 0.0095, 0.0105, 0.0095, 0.040, 0.028])
_MV = np.array([[0.14, -0.11, 1.15, -0.20, 0.17, 0.16], [0.10, -0.16, 1.45, -0.34, 0.22, 0.20]])
_ECTOPIC_S = np.array([-0.060, 0.0, 0.075, 0.300])
_ECTOPIC_WIDTHS_S = np.array([0.024, 0.026, 0.030, 0.060])
_ECTOPIC_MV = np.array([[-0.12, 1.45, -0.55, -0.45], [-0.25, 1.20, -0.80, -0.35]])
"""Broad QRS without a P wave and a T wave of opposite sign."""


@dataclass(frozen=True, slots=True)
class EcgSpec:
    """Recording of an ECG and its disturbances.

    Attributes:
        rate_hz: sampling rate.
        leads: 1 or 2.
        respiration_hz, respiratory_gain: breathing modulates the amplitude of every beat.
        baseline_mv: RMS of the baseline wander.
        emg_mv: RMS of muscle noise, 20 Hz to 0.4 of the sampling rate.
        mains_mv, mains_hz: amplitude and frequency of mains interference (with its third harmonic).
        resolution_mv: step of the digitiser.
        lead_off_s: (start, stop) pairs in which the electrodes are off: a flat line.
        noise_bursts_s: (start, stop) pairs with strong noise: electrocautery, a patient who shivers.
        burst_mv: RMS of that noise, in the muscle's band.
        missed_beats: indices of beats that leave no trace in the ECG although the heart beat; beat 0 is the
            first with an R peak in the recording.
        latency_s: delay of every sample's stamp after its measurement, by a filter or a clock that was never
            set.
    """

    rate_hz: float = 500.0
    leads: int = 2
    respiration_hz: float = 0.25
    respiratory_gain: float = 0.05
    baseline_mv: float = 0.06
    emg_mv: float = 0.02
    mains_mv: float = 0.012
    mains_hz: float = 50.0
    resolution_mv: float = 0.0025
    lead_off_s: tuple[tuple[float, float], ...] = ()
    noise_bursts_s: tuple[tuple[float, float], ...] = ()
    burst_mv: float = 0.8
    missed_beats: tuple[int, ...] = ()
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        if self.leads not in (1, 2) or not 100.0 <= self.rate_hz <= 10_000.0:
            raise InvalidInputError(
                f"the ECG has {self.leads} leads at {self.rate_hz:g} Hz; needed 1 or 2, and 100 to 10 000 Hz"
            )
        if not 0.0 <= self.latency_s <= 10.0:
            raise InvalidInputError(f"the ECG is stamped {self.latency_s:g} s late; needed 0 to 10 s")
        sizes = (self.baseline_mv, self.emg_mv, self.mains_mv, self.burst_mv)
        if min(sizes) < 0 or self.resolution_mv <= 0:
            raise InvalidInputError("an ECG disturbance is negative, or its resolution is not positive")
        if any(a >= b for a, b in (*self.lead_off_s, *self.noise_bursts_s)):
            raise InvalidInputError("an ECG disturbance ends before it begins; give (start, stop)")


def clean_ecg(
    beats: Beats, t_s: FloatArray, spec: EcgSpec, volume: Callable[[float], float] | None = None
) -> FloatArray:
    """Compute (n, leads) mV without any disturbance; each R wave peaks at its R peak.

    Args:
        volume: of the lung, 0 to about 1, at a time: a full one makes beats small; None: steady breathing.
    """
    out = np.zeros((len(t_s), spec.leads))
    rr_before = np.diff(beats.r_peaks_s, prepend=2 * beats.r_peaks_s[0] - beats.r_peaks_s[1])
    first_beat = int(np.searchsorted(beats.r_peaks_s, t_s[0]))
    for k, r_s in enumerate(beats.r_peaks_s):
        if k - first_beat in spec.missed_beats:
            continue
        offsets_s, widths_s, mv = _beat_waves(float(rr_before[k]), bool(beats.ectopic[k]))
        first, last = np.searchsorted(t_s, (r_s - 0.35, r_s + 0.75))
        local = t_s[first:last, None] - r_s - offsets_s
        waves = np.exp(-0.5 * (local / widths_s) ** 2)
        breath = np.sin(2 * np.pi * spec.respiration_hz * r_s) if volume is None else 1.0 - 2.0 * volume(r_s)
        gain = 1.0 + spec.respiratory_gain * breath
        out[first:last] += gain * waves @ mv[: spec.leads].T
    return out


def _beat_waves(rr_s: float, ectopic: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute wave centres relative to R (s), widths (s) and amplitudes (leads, waves) after an interval."""
    scale = float(np.clip(rr_s, 0.35, 1.6)) ** 0.2
    if ectopic:
        return _ECTOPIC_S, _ECTOPIC_WIDTHS_S, _ECTOPIC_MV
    stretch = np.array([scale, 1.0, 1.0, 1.0, scale, scale])
    return _WAVES_S * stretch, _WIDTHS_S * stretch, _MV


def synthetic_ecg(
    beats: Beats,
    seconds: float,
    spec: EcgSpec,
    rng: np.random.Generator,
    volume: Callable[[float], float] | None = None,
) -> Signal:
    """Simulate an ECG from 0 to `seconds`, stamped when measured: without `latency_s`."""
    n = round(seconds * spec.rate_hz)
    t_s = np.arange(n) / spec.rate_hz
    mv = clean_ecg(beats, t_s, spec, volume)
    for lead in range(spec.leads):
        mv[:, lead] += _baseline(t_s, spec, rng) + _muscle(n, spec, rng) + _mains(t_s, spec, rng)
    for start_s, stop_s in spec.noise_bursts_s:
        inside = (t_s >= start_s) & (t_s < stop_s)
        strong = replace(spec, emg_mv=spec.burst_mv)
        for lead in range(spec.leads):
            mv[inside, lead] += _muscle(n, strong, rng)[inside]
    for start_s, stop_s in spec.lead_off_s:
        mv[(t_s >= start_s) & (t_s < stop_s)] = 0.0
    mv = np.round(mv / spec.resolution_mv) * spec.resolution_mv
    return Signal(np.round(mv, 6), spec.rate_hz, 0.0, LEADS[: spec.leads])


def _baseline(t_s: FloatArray, spec: EcgSpec, rng: np.random.Generator) -> FloatArray:
    """Draw breathing plus slow drift below 0.3 Hz, of the specified RMS."""
    frequencies = np.concatenate([[spec.respiration_hz], rng.uniform(0.03, 0.3, 5)])
    weights = np.concatenate([[1.0], rng.uniform(0.2, 0.6, 5)])
    phases = rng.uniform(0, 2 * np.pi, 6)
    wander = np.sin(2 * np.pi * t_s[:, None] * frequencies + phases) @ weights
    return np.asarray(wander * spec.baseline_mv / np.sqrt(0.5 * np.sum(weights**2)))


def _muscle(n: int, spec: EcgSpec, rng: np.random.Generator) -> FloatArray:
    """Draw white noise band-passed to the muscle's band, of the specified RMS."""
    sos = butter(2, (20.0, 0.4 * spec.rate_hz), btype="bandpass", fs=spec.rate_hz, output="sos")
    noise = sosfiltfilt(sos, rng.standard_normal(n + 200))[100:-100]
    return np.asarray(noise * spec.emg_mv / noise.std())


def _mains(t_s: FloatArray, spec: EcgSpec, rng: np.random.Generator) -> FloatArray:
    phase = rng.uniform(0, 2 * np.pi, 2)
    turn = 2 * np.pi * spec.mains_hz * t_s
    return np.asarray(spec.mains_mv * (np.sin(turn + phase[0]) + 0.2 * np.sin(3 * turn + phase[1])))
