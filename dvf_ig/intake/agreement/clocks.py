"""Whether the recordings were made at one time: how much of it they share, and how fast the heart beats."""

from collections.abc import Iterator

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.intake.agreement.finding import Disagreement, Finding, finding
from dvf_ig.intake.parts import SessionParts
from dvf_ig.intake.problem import Use

LEAST_SHARE = 0.5
RATE_RATIO = 2.5
"""A heart under stress beats twice as fast as in the scanner; a sampling rate that is wrong is so by more."""


def clock_findings(parts: SessionParts, peaks_s: FloatArray) -> Iterator[Finding]:
    """What was recorded at another time, or with another rate.

    Args:
        peaks_s: (k,) R peaks of the ECG.
    """
    if parts.ecg is None:
        return
    ecg_s = parts.ecg.t_s
    others: list[tuple[str, FloatArray, Use]] = []
    if parts.sweep is not None:
        others.append(("ultrasound", parts.sweep.recorded.t_s, "register"))
    if parts.tool is not None:
        others.append(("tool", parts.tool.t_s, "replay"))
    for what, t_s, use in others:
        share = float(np.mean((t_s >= ecg_s[0]) & (t_s <= ecg_s[-1])))
        if 0.0 < share < LEAST_SHARE:
            yield finding(Disagreement.LITTLE_COMMON_TIME, "ecg", use, what=what, share=share)
    yield from _rate(parts, peaks_s)


def _rate(parts: SessionParts, peaks_s: FloatArray) -> Iterator[Finding]:
    timing = _timing(parts)
    if timing is None or len(peaks_s) < 3:
        return
    rr_s = float(np.median(np.diff(peaks_s)))
    if max(rr_s / timing, timing / rr_s) > RATE_RATIO:
        yield finding(Disagreement.ECG_OF_ANOTHER_RATE, "ecg", bpm=60.0 / rr_s, model_bpm=60.0 / timing)


def _timing(parts: SessionParts) -> float | None:
    """RR interval of the pre-operative heart in s; None where it was assumed."""
    if parts.preop is None:
        return None
    preop, model = parts.preop.preop, parts.preop.model
    timing = model.timing if model is not None else None
    for series in (preop.labels, preop.mr, *preop.surfaces):
        timing = timing or (None if series is None else series.timing)
    return None if timing is None or timing.rr_assumed else timing.rr_s
