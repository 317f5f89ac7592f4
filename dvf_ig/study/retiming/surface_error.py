"""Uniform against two-segment retiming of the pre-operative cycle, on a heart that obeys a law of systole."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.clock import two_segment_phase
from data_synth.heart.motion import MotionPreset
from dvf_ig.cardiac import SYSTOLE_SLOPE_S_PER_BPM, RetimeMode, retime
from dvf_ig.core import FloatArray, InvalidInputError

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
    """Distance between the surface shown and the true one, over a beat and over epicardial points.

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


def compare_retiming(
    rates_bpm: Sequence[float],
    *,
    motion: MotionPreset = "physiological",
    true_slopes_s_per_bpm: Sequence[float] = TRUE_SLOPES_S_PER_BPM,
    seed: int = 1,
) -> tuple[RetimingRow, ...]:
    """Surface error of each method at steady rates.

    The two-segment method assumes the law by which this heart beats, with k = 2 ms per beat/min: where the
    true slope is the same it must be exact, and only the other slopes say what it is worth.

    Args:
        rates_bpm: heart rates, 25 to 220 per minute.
        motion: how far the phantom's heart moves.
        true_slopes_s_per_bpm: true k, each looked at.
        seed: draws the heart.
    Raises:
        InvalidInputError: a rate out of range.
    """
    bad = [rate for rate in rates_bpm if not 25.0 <= rate <= 220.0]
    if bad or not rates_bpm:
        raise InvalidInputError(f"heart rates are {list(rates_bpm)}; needed 25 to 220 per minute")
    anatomy = phantom_anatomy(motion=motion, mismatch_mm=0.0, seed=seed)
    surface = _tabulated(anatomy)
    return tuple(
        row
        for slope in true_slopes_s_per_bpm
        for rate in rates_bpm
        for row in _rows_at(anatomy, surface, rate, slope)
    )


def _rows_at(anatomy: PhantomAnatomy, surface: FloatArray, rate: float, slope: float) -> list[RetimingRow]:
    phi = (np.arange(MOMENTS) + 0.5) / MOMENTS
    rr_s = 60.0 / rate
    truth = two_segment_phase(phi, np.full(MOMENTS, rr_s), anatomy.rr_s, anatomy.es_fraction, slope)
    true_surface, systole = _at(surface, truth), truth < anatomy.es_fraction
    rows = []
    for method in METHODS:
        apart = np.linalg.norm(_at(surface, _shown(method, phi, rr_s, anatomy)) - true_surface, axis=2)
        mean, p95, worst = float(apart.mean()), float(np.percentile(apart, 95)), float(apart.max())
        rows.append(
            RetimingRow(rate, slope, method, mean, p95, worst, float(np.percentile(apart[systole], 95)))
        )
    return rows


def _shown(method: str, phi: FloatArray, rr_s: float, anatomy: PhantomAnatomy) -> FloatArray:
    """Model phase that a method shows at fractions `phi` of a beat of length `rr_s`."""
    if method == "not retimed":
        # the cine runs at the speed of its own RR, is held at its end, and restarted by R
        return np.asarray(np.minimum(phi * rr_s / anatomy.rr_s, np.nextafter(1.0, 0.0)))
    mode: RetimeMode = "uniform" if method == "uniform" else "two-segment"
    return retime(phi, rr_s, anatomy.rr_s, anatomy.es_fraction, mode)


def _tabulated(anatomy: PhantomAnatomy) -> FloatArray:
    """(PHASES, POINTS, 3) epicardial points spread over the heart, at equal steps of the cycle."""
    stride = max(1, len(anatomy.ed_vertices_mm) // POINTS)
    points = anatomy.ed_vertices_mm[::stride]
    return np.stack([anatomy.deformed(points, k / PHASES) for k in range(PHASES)])


def _at(surface: FloatArray, phase: FloatArray) -> FloatArray:
    """(n, points, 3) surface at phases, linear between tabulated ones (cyclic)."""
    position = (phase % 1.0) * PHASES
    first = position.astype(np.int64) % PHASES
    weight = (position - np.floor(position))[:, None, None]
    return np.asarray((1 - weight) * surface[first] + weight * surface[(first + 1) % PHASES])
