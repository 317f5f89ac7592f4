"""Uniform against two-segment retiming of the pre-operative cycle, on a heart that obeys a law of systole."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.clock import two_segment_phase
from data_synth.heart.motion import MotionPreset
from dvf_ig.cardiac import SYSTOLE_SLOPE_S_PER_BPM, RetimeMode, retime
from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, read_only_arrays

RATES_BPM = (45.0, 60.0, 75.0, 90.0, 105.0, 120.0)
PHASES = 80
"""Surfaces tabulated over the pre-operative cycle."""
MOMENTS = 200
"""Moments looked at in each beat."""
POINTS = 800
METHODS = ("not retimed", "uniform", "two-segment")
TRUE_SLOPES_S_PER_BPM = (0.0013, SYSTOLE_SLOPE_S_PER_BPM, 0.0027)
"""How much true systole shortens per beat/min: the law's value and a third to either side of it."""


@dataclass(frozen=True, slots=True)
class RetimingRow:
    """Distance between the surface shown and the true one, over a beat and epicardial points of all hearts.

    Attributes:
        rate_bpm: steady heart rate.
        true_slope_s_per_bpm: how much the true systole shortens per beat/min.
        method: one of METHODS; "not retimed" plays the cine at its own speed from each R peak.
        mean_mm, p95_mm, max_mm: of the point-wise distance.
        systole_p95_mm: p95 during true systole alone.
    """

    rate_bpm: float
    true_slope_s_per_bpm: float
    method: str
    mean_mm: float
    p95_mm: float
    max_mm: float
    systole_p95_mm: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Heart:
    """A heart with its epicardium (PHASES, points, 3) at equal steps of the cycle."""

    anatomy: PhantomAnatomy
    surface_mm: FloatArray

    def surface_at(self, phase: FloatArray) -> FloatArray:
        """(n, points, 3) surface at phases, linear between tabulated ones (cyclic)."""
        position = (phase % 1.0) * PHASES
        first = position.astype(np.int64) % PHASES
        weight = (position - np.floor(position))[:, None, None]
        after = (first + 1) % PHASES
        return np.asarray((1 - weight) * self.surface_mm[first] + weight * self.surface_mm[after])


def compare_retiming(
    rates_bpm: Sequence[float],
    *,
    motion: MotionPreset = "physiological",
    true_slopes_s_per_bpm: Sequence[float] = TRUE_SLOPES_S_PER_BPM,
    seeds: Sequence[int] = (1,),
) -> tuple[RetimingRow, ...]:
    """Surface error of each method at steady rates.

    The two-segment method assumes the law by which these hearts beat, with k = 2 ms per beat/min: where the
    true slope is the same it must be exact, and only the other slopes say what it is worth.

    Args:
        rates_bpm: heart rates, 25 to 220 per minute.
        motion: how far the phantom's heart moves.
        true_slopes_s_per_bpm: true k, each looked at.
        seeds: one a heart, at least one.
    Raises:
        InvalidInputError: a rate out of range.
    """
    bad = [rate for rate in rates_bpm if not 25.0 <= rate <= 220.0]
    if bad or not rates_bpm:
        raise InvalidInputError(f"heart rates are {list(rates_bpm)}; needed 25 to 220 per minute")
    hearts = [_heart(motion, seed) for seed in seeds]
    return tuple(
        _row(hearts, rate, slope, method)
        for slope in true_slopes_s_per_bpm
        for rate in rates_bpm
        for method in METHODS
    )


def _row(hearts: Sequence[_Heart], rate_bpm: float, slope_s_per_bpm: float, method: str) -> RetimingRow:
    errors = [_errors(heart, 60.0 / rate_bpm, slope_s_per_bpm, method) for heart in hearts]
    every = np.concatenate([error_mm.ravel() for error_mm, _ in errors])
    systolic = np.concatenate([error_mm[systole].ravel() for error_mm, systole in errors])
    return RetimingRow(
        rate_bpm=rate_bpm,
        true_slope_s_per_bpm=slope_s_per_bpm,
        method=method,
        mean_mm=float(every.mean()),
        p95_mm=float(np.percentile(every, 95)),
        max_mm=float(every.max()),
        systole_p95_mm=float(np.percentile(systolic, 95)),
    )


def _errors(heart: _Heart, rr_s: float, slope_s_per_bpm: float, method: str) -> tuple[FloatArray, BoolArray]:
    """(MOMENTS, points) distance over a beat of length `rr_s`, and which of its moments are true systole."""
    anatomy = heart.anatomy
    phi = (np.arange(MOMENTS) + 0.5) / MOMENTS
    truth = two_segment_phase(phi, np.full(MOMENTS, rr_s), anatomy.rr_s, anatomy.es_fraction, slope_s_per_bpm)
    shown = _shown(method, phi, rr_s, anatomy)
    error_mm = np.linalg.norm(heart.surface_at(shown) - heart.surface_at(truth), axis=2)
    return error_mm, truth < anatomy.es_fraction


def _shown(method: str, phi: FloatArray, rr_s: float, anatomy: PhantomAnatomy) -> FloatArray:
    """Model phase that a method shows at fractions `phi` of a beat of length `rr_s`."""
    if method == "not retimed":
        # the cine runs at the speed of its own RR, is held at its end, and restarted by R
        return np.asarray(np.minimum(phi * rr_s / anatomy.rr_s, np.nextafter(1.0, 0.0)))
    mode: RetimeMode = "uniform" if method == "uniform" else "two-segment"
    return retime(phi, rr_s, anatomy.rr_s, anatomy.es_fraction, mode)


def _heart(motion: MotionPreset, seed: int) -> _Heart:
    anatomy = phantom_anatomy(motion=motion, mismatch_mm=0.0, seed=seed)
    stride = max(1, len(anatomy.ed_vertices_mm) // POINTS)
    points = anatomy.ed_vertices_mm[::stride]
    return _Heart(anatomy, np.stack([anatomy.deformed(points, k / PHASES) for k in range(PHASES)]))
