"""R peaks and phase against annotated recordings: sensitivity, delay, phase error and its stated σ."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np

from dvf_ig.cardiac import (
    PREDICTORS,
    PredictorName,
    RPeak,
    make_predictor,
    phase_from_peaks,
    stream_recording,
)
from dvf_ig.core import (
    BoolArray,
    FloatArray,
    IntArray,
    InvalidInputError,
    PhaseTrack,
    Signal,
    read_only_arrays,
)
from dvf_ig.io import BeatAnnotations

PHASE_RATE_HZ = 20.0
FIBRILLATION = "AFIB"
ECTOPIC_BEATS = frozenset("VFEAaJS!")
ECTOPIC_SHARE = 0.02
"""A recording with this share of ectopic beats is called ectopic."""
FIBRILLATION_SHARE = 0.1
"""A recording in atrial fibrillation for this share of its time is called fibrillation."""
TUNING_RECORDS = frozenset(("109", "114", "116", "118", "124", "205", "207", "209", "215", "220", "230"))
"""Records of the MIT-BIH database on which the phase clock's limits were chosen; all others are held out."""
RISK_POINTS = 60
RHYTHMS = ("sinus", "ectopic", "fibrillation")


@dataclass(frozen=True, slots=True)
class BeatScore:
    """R peaks against annotated beats, matched one to one.

    Attributes:
        beats, found: how many there are, and how many the detector gave.
        hits_150, hits_50: pairs within 150 and 50 ms.
        timing_ms: median |detected − annotated| of the pairs within 150 ms.
        latency_p95_ms: from the R peak to the sample at which it was detected, after the learning time.
        speed: recorded over processor time, detection and phase together.
    """

    beats: int
    found: int
    hits_150: int
    hits_50: int
    timing_ms: float
    latency_p95_ms: float
    speed: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PhaseErrors:
    """Phase at PHASE_RATE_HZ between the first and the last annotated beat.

    Attributes:
        error: (n,) estimated minus true phase, wrapped to ±0.5; the truth is the share of the annotated RR.
        sigma: (n,) what the clock said its standard deviation was.
        valid: (n,) LOCKED.
        fibrillation: (n,) annotated as atrial fibrillation.
    """

    error: FloatArray
    sigma: FloatArray
    valid: BoolArray
    fibrillation: BoolArray


@dataclass(frozen=True, slots=True)
class PhaseSummary:
    """How accurate phase was, and how much of the time it was valid.

    Attributes:
        valid_share: of the time.
        mean_percent, p95_percent: |error| where valid, % of RR; NaN where nothing is valid.
        within_2_sigma: share of valid moments whose error lies within two stated standard deviations.
        fibrillation_refused: share of annotated fibrillation in which phase was invalid; NaN without any.
    """

    valid_share: float
    mean_percent: float
    p95_percent: float
    within_2_sigma: float
    fibrillation_refused: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RecordGating:
    """One recording's scores; `predictors`: (n,) |phase error| of each predictor on its annotated beats."""

    name: str
    rhythm: str
    tuning: bool
    beats: BeatScore
    errors: PhaseErrors
    predictors: dict[PredictorName, FloatArray]

    @property
    def phase(self) -> PhaseSummary:
        return summarise_phase([self.errors])


def score_record(name: str, signal: Signal, truth: BeatAnnotations) -> RecordGating:
    """Stream one recording through detector and clock and compare with its annotations.

    Raises:
        InvalidInputError: fewer than ten annotated beats.
    """
    if len(truth.t_s) < 10:
        raise InvalidInputError(f"record {name} has {len(truth.t_s)} annotated beats; needed at least 10")
    t_s = signal.start_s + np.arange(int(len(signal) / signal.rate_hz * PHASE_RATE_HZ)) / PHASE_RATE_HZ
    began = process_time()
    peaks, changes = stream_recording(signal)
    track = phase_from_peaks(peaks, changes, t_s)
    seconds = process_time() - began
    errors = phase_errors(track, truth)
    return RecordGating(
        name=name,
        rhythm=rhythm_class(truth, t_s),
        tuning=name in TUNING_RECORDS,
        beats=score_beats(peaks, truth.t_s, len(signal) / signal.rate_hz / max(seconds, 1e-9)),
        errors=errors,
        predictors={which: predictor_errors(which, truth.t_s) for which in PREDICTORS},
    )


def rhythm_class(truth: BeatAnnotations, t_s: FloatArray) -> str:
    """ "fibrillation", "ectopic" or "sinus", from the annotations alone."""
    if truth.within(FIBRILLATION, t_s).mean() >= FIBRILLATION_SHARE:
        return "fibrillation"
    share = np.mean([symbol in ECTOPIC_BEATS for symbol in truth.symbols])
    return "ectopic" if share >= ECTOPIC_SHARE else "sinus"


def score_beats(peaks: Sequence[RPeak], truth_s: FloatArray, speed: float) -> BeatScore:
    """R peaks, in the order of their detection, against annotated times."""
    found = np.array([peak.t_s for peak in peaks])
    order = np.argsort(found, kind="stable")
    delays = np.array([peak.detected_at_s - peak.t_s for peak in peaks])[order]
    hits, partner = match_beats(found[order], truth_s, 0.15)
    apart = np.abs(found[order][partner] - truth_s[hits])
    return BeatScore(
        beats=len(truth_s),
        found=len(found),
        hits_150=len(hits),
        hits_50=len(match_beats(found[order], truth_s, 0.05)[0]),
        timing_ms=float(1000 * np.median(apart)) if len(apart) else float("nan"),
        # the beats of the learning time are detected only after it
        latency_p95_ms=float(1000 * np.percentile(delays[4:], 95)) if len(delays) > 4 else float("nan"),
        speed=speed,
    )


def match_beats(found_s: FloatArray, truth_s: FloatArray, window_s: float) -> tuple[IntArray, IntArray]:
    """Pairs (truth, found) within the window, one to one, in order; a nearer next detection is preferred."""
    pairs: list[tuple[int, int]] = []
    i = j = 0
    while i < len(truth_s) and j < len(found_s):
        gap = found_s[j] - truth_s[i]
        if abs(gap) <= window_s:
            if j + 1 < len(found_s) and abs(found_s[j + 1] - truth_s[i]) < abs(gap):
                j += 1
                continue
            pairs.append((i, j))
            i, j = i + 1, j + 1
        elif gap < 0:
            j += 1
        else:
            i += 1
    matched = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return matched[:, 0], matched[:, 1]


def phase_errors(track: PhaseTrack, truth: BeatAnnotations) -> PhaseErrors:
    """Errors of a track wherever two annotated beats enclose the moment."""
    beats = truth.t_s
    inside = (track.t_s >= beats[0]) & (track.t_s < beats[-1])
    t_s = track.t_s[inside]
    k = np.searchsorted(beats, t_s, side="right") - 1
    true_phi = (t_s - beats[k]) / (beats[k + 1] - beats[k])
    error = (track.phi[inside] - true_phi + 0.5) % 1.0 - 0.5
    fibrillation = truth.within(FIBRILLATION, t_s)
    return PhaseErrors(error, track.sigma_phi[inside], track.valid[inside], fibrillation)


def predictor_errors(name: PredictorName, beats_s: FloatArray) -> FloatArray:
    """(n,) |phase error| over the cycles of annotated beats, from the RR that a predictor expected.

    R peaks are given without delay here and nothing is refused: it compares predictors, not the whole clock.
    """
    predictor = make_predictor(name)
    expected = np.empty(len(beats_s) - 1)
    intervals = np.diff(beats_s)
    for k, interval_s in enumerate(intervals.tolist()):
        expected[k] = predictor.predict()
        predictor.add(interval_s)
    known = np.isfinite(expected)
    expected, intervals = expected[known], intervals[known]
    steps = np.maximum(1, np.rint(intervals * PHASE_RATE_HZ)).astype(np.int64)
    beat = np.repeat(np.arange(len(steps)), steps)
    nth = np.arange(len(beat)) - np.repeat(np.cumsum(steps) - steps, steps)
    phi = (nth + 0.5) / steps[beat]
    error = phi * intervals[beat] / expected[beat] - phi
    return np.asarray(np.abs((error + 0.5) % 1.0 - 0.5))


def summarise_phase(parts: Sequence[PhaseErrors]) -> PhaseSummary:
    """Several recordings' errors pooled, each moment counting the same."""
    pooled = pool(parts)
    error, valid = np.abs(pooled.error), pooled.valid
    used = error[valid]
    nothing = float("nan")
    return PhaseSummary(
        valid_share=float(valid.mean()),
        mean_percent=float(100 * used.mean()) if len(used) else nothing,
        p95_percent=float(100 * np.percentile(used, 95)) if len(used) else nothing,
        within_2_sigma=float((used < 2 * pooled.sigma[valid]).mean()) if len(used) else nothing,
        fibrillation_refused=(
            float(1.0 - valid[pooled.fibrillation].mean()) if pooled.fibrillation.any() else nothing
        ),
    )


def pool(parts: Sequence[PhaseErrors]) -> PhaseErrors:
    """Errors of several recordings one after the other."""
    return PhaseErrors(
        np.concatenate([p.error for p in parts]),
        np.concatenate([p.sigma for p in parts]),
        np.concatenate([p.valid for p in parts]),
        np.concatenate([p.fibrillation for p in parts]),
    )


def risk_coverage(errors: PhaseErrors) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Risk–coverage curve (El-Yaniv and Wiener 2010) of refusing by σφ alone, whatever the state.

    Returns:
        (k,) coverage: share of the time with σφ below a threshold; risk: p95 of |error| there in % of RR; the
        threshold.
    """
    known = np.isfinite(errors.sigma)
    order = np.argsort(errors.sigma[known], kind="stable")
    error, sigma = np.abs(errors.error[known][order]), errors.sigma[known][order]
    counts = np.unique(np.linspace(max(1, len(order) // 50), len(order), RISK_POINTS).astype(np.int64))
    p95 = np.array([100 * np.percentile(error[:count], 95) for count in counts])
    return counts / len(errors.error), p95, sigma[counts - 1]
