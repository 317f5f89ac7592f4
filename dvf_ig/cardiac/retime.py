"""Heart-rate retiming and T_d: from phase in the current beat to phase of the model (Ren 2008, Section VII).

Ren 2008 shows each of the model's N frames for T_d = RR/N (`frame_period_s`): the model's phase advances
evenly from R to R, which is `retime` in mode "uniform". The clock gives phase, time since R over the
predicted RR, so T_d enters through that RR; `dvf-ig replay` reports T_d next to it.
"""

from typing import Literal

import numpy as np

from dvf_ig.core import CubicPieces, FloatArray, InvalidInputError, RetimingCurve

RetimeMode = Literal["uniform", "two-segment"]

SYSTOLE_SLOPE_S_PER_BPM = 0.002
"""k: how much systole shortens per beat/min (Weissler: LVET 1.7 ms, QS2 2.1 ms per beat/min in men)."""
SYSTOLE_BOUNDS = (0.25, 0.65)
"""Systole stays within these shares of the predicted RR interval."""


def retime(
    phi: FloatArray | float,
    rr_s: FloatArray | float,
    timing_rr_s: float,
    es_fraction: float,
    mode: RetimeMode = "uniform",
    *,
    slope_s_per_bpm: float = SYSTOLE_SLOPE_S_PER_BPM,
) -> FloatArray:
    """Compute model phase at fraction `phi` of a beat that lasts `rr_s`.

    Args:
        phi: (...) in [0, 1), share of the current RR interval since R.
        rr_s: (...) its predicted length.
        timing_rr_s: RR interval at which the model was acquired.
        es_fraction: end-systole as a share of that interval, measured in the model's own images.
        mode: "uniform" stretches the whole cycle (Ren 2008, Section VII); "two-segment" shortens systole by
            `slope_s_per_bpm` and lets diastole take the rest, joined by a monotone periodic cubic.
    Returns:
        (...) model phase in [0, 1), increasing with phi; equal to phi if rr_s equals timing_rr_s.
    Raises:
        InvalidInputError: unknown mode, or an RR interval or end-systole out of range.
    Source: Ren 2008, Section VII (uniform); Weissler 1968 for the slope; docs/theory/cardiac.md.
    """
    _check(timing_rr_s, es_fraction, mode)
    phase, rr = np.broadcast_arrays(
        np.asarray(phi, dtype=np.float64) % 1.0, np.asarray(rr_s, dtype=np.float64)
    )
    _check_rr(rr)
    if mode == "uniform":
        return np.array(phase)
    systole = systole_share(rr, timing_rr_s, es_fraction, slope_s_per_bpm=slope_s_per_bpm)
    return _joined(systole, es_fraction).at(phase)


def retiming_curve(
    rr_s: float,
    timing_rr_s: float,
    es_fraction: float,
    mode: RetimeMode = "uniform",
    *,
    slope_s_per_bpm: float = SYSTOLE_SLOPE_S_PER_BPM,
) -> RetimingCurve:
    """Build `retime` of one beat as a function of phase; arguments and errors are those of `retime`."""
    _check(timing_rr_s, es_fraction, mode)
    _check_rr(np.asarray(rr_s))
    if mode == "uniform":
        return RetimingCurve.uniform()
    systole = systole_share(rr_s, timing_rr_s, es_fraction, slope_s_per_bpm=slope_s_per_bpm)
    return RetimingCurve(*(float(number) for number in _joined(systole, es_fraction)))


def _check(timing_rr_s: float, es_fraction: float, mode: RetimeMode) -> None:
    if mode not in ("uniform", "two-segment"):
        raise InvalidInputError(f"retiming '{mode}' is unknown; choose uniform or two-segment")
    if not timing_rr_s > 0 or not 0.05 < es_fraction < 0.95:
        raise InvalidInputError(
            f"the model was acquired at RR {timing_rr_s:g} s with end-systole at {es_fraction:g} of the "
            "cycle; needed RR above 0 and end-systole within 0.05 to 0.95"
        )


def _check_rr(rr_s: FloatArray) -> None:
    if not (rr_s > 0).all():
        raise InvalidInputError("retiming needs an RR interval above 0 s; use phase only while it is valid")


def systole_share(
    rr_s: FloatArray | float,
    timing_rr_s: float,
    es_fraction: float,
    *,
    slope_s_per_bpm: float = SYSTOLE_SLOPE_S_PER_BPM,
) -> FloatArray:
    """Compute systole's (...) share of a beat of length `rr_s`: S/RR, S = S0 + k(HR0 − HR), limited."""
    rr = np.asarray(rr_s, dtype=np.float64)
    systole_s = es_fraction * timing_rr_s + slope_s_per_bpm * (60.0 / timing_rr_s - 60.0 / rr)
    low, high = min(SYSTOLE_BOUNDS[0], es_fraction), max(SYSTOLE_BOUNDS[1], es_fraction)
    return np.asarray(np.clip(systole_s / rr, low, high))


def frame_period_s(rr_s: float, frames: int) -> float:
    """Compute T_d = RR / N, the time of each of the model's N frames in a beat of `rr_s` (Section VII).

    Raises:
        InvalidInputError: no frames, or an RR interval that is not positive.
    """
    if frames < 1 or not rr_s > 0:
        raise InvalidInputError(
            f"T_d of {frames} frames at RR {rr_s:g} s; needed at least 1 frame and RR above 0"
        )
    return rr_s / frames


def _joined(systole: FloatArray, es_fraction: float) -> CubicPieces:
    """Build the monotone cubic through (0, 0), (systole, es), (1, 1), continued periodically on both sides.

    With three knots a period PCHIP's slopes have a closed form, so that every beat may have its own systole.
    """
    rise, rest = es_fraction / systole, (1.0 - es_fraction) / (1.0 - systole)
    at_breakpoint = _pchip_slope(systole, 1.0 - systole, rise, rest)
    at_r = _pchip_slope(1.0 - systole, systole, rest, rise)
    return CubicPieces(systole, es_fraction, at_r, at_breakpoint)


def _pchip_slope(before: FloatArray, after: FloatArray, rise: FloatArray, fall: FloatArray) -> FloatArray:
    """Slope between two intervals of widths `before`, `after` and chords `rise`, `fall` (Fritsch–Butland)."""
    first, second = 2 * after + before, after + 2 * before
    return np.asarray((first + second) / (first / rise + second / fall))
