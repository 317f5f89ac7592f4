"""Beats of the synthetic heart: RR series with variability, rate ramps and early beats."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, read_only_arrays

SHORTEST_RR_S = 0.24


@dataclass(frozen=True, slots=True)
class RhythmSpec:
    """Parameters of the variation of the RR interval.

    Attributes:
        rate_bpm: (time s, beats/min) knots, linear between, constant outside: a ramp needs two.
        respiratory: relative amplitude of respiratory sinus arrhythmia.
        respiration_hz: breathing rate (ventilator).
        mayer: relative amplitude of the slow (0.1 Hz) component.
        jitter: relative SD of the beat-to-beat white component.
        ectopic_share: probability that a beat comes early (a ventricular extrasystole, then a full
            compensatory pause).
        prematurity: RR before an early beat as a share of the regular one.
    """

    rate_bpm: tuple[tuple[float, float], ...] = ((0.0, 72.0),)
    respiratory: float = 0.02
    respiration_hz: float = 0.25
    mayer: float = 0.012
    jitter: float = 0.004
    ectopic_share: float = 0.0
    prematurity: float = 0.65

    def __post_init__(self) -> None:
        times = [t for t, _ in self.rate_bpm]
        if not times or times != sorted(set(times)):
            raise InvalidInputError(f"rate knots are at {times} s; needed at least one, increasing")
        for _, rate in self.rate_bpm:
            if not 25.0 <= rate <= 220.0:
                raise InvalidInputError(f"heart rate is {rate:g}/min; needed 25 to 220")


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Beats:
    """R peaks with the kind of each beat.

    Attributes:
        r_peaks_s: (k,) increasing.
        ectopic: (k,) True for a ventricular extrasystole.
    """

    r_peaks_s: FloatArray
    ectopic: BoolArray


def beat_series(
    spec: RhythmSpec,
    start_s: float,
    stop_s: float,
    rng: np.random.Generator,
    volume: Callable[[float], float] | None = None,
) -> Beats:
    """Draw R peaks from at or before `start_s` to at or after `stop_s`.

    RR_k = 60/rate(t) · (1 + respiratory·sin(2πf t + a) + mayer·sin(2π 0.1 t + b) + jitter·ε).

    Args:
        volume: of the lung, 0 to about 1, at a time; in place of the sine stands 1 − 2·volume: a full lung
            quickens the heart.
    """
    knots_s, rates = (np.array(column) for column in zip(*spec.rate_bpm, strict=True))
    breath, slow = rng.uniform(0, 2 * np.pi, 2)
    first = 60.0 / float(np.interp(start_s, knots_s, rates))
    peaks, ectopic = [start_s - first * float(rng.uniform(0.05, 1.0))], [False]
    pause = 0.0
    while peaks[-1] < stop_s:
        t = peaks[-1]
        rr = 60.0 / float(np.interp(t, knots_s, rates))
        rr *= 1.0 + spec.respiratory * (
            np.sin(2 * np.pi * spec.respiration_hz * t + breath) if volume is None else 1.0 - 2.0 * volume(t)
        )
        rr *= 1.0 + spec.mayer * np.sin(2 * np.pi * 0.1 * t + slow)
        rr *= 1.0 + spec.jitter * float(rng.standard_normal())
        early = float(rng.uniform()) < spec.ectopic_share and pause == 0.0
        step = rr * spec.prematurity if early else rr + pause
        pause = rr * (1.0 - spec.prematurity) if early else 0.0
        peaks.append(t + max(float(step), SHORTEST_RR_S))
        ectopic.append(early)
    return Beats(np.array(peaks), np.array(ectopic))
