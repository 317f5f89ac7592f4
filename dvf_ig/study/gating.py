"""Score R peaks and phase against annotated ECGs; phase by rhythm, tuning records apart.

Sensitivity, precision, timing, delay, phase error and its stated σ. The unit is the record. The phase clock's
limits were chosen on TUNING_RECORDS; all others are held out.

    dvf-ig study gating --records mitdb -o study
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from dvf_ig.cardiac import PREDICTORS, PredictorName, make_predictor, phase_from_peaks, stream_recording
from dvf_ig.cardiac.rpeak import RPeak
from dvf_ig.core import InvalidInputError, PhaseTrack, Signal
from dvf_ig.core.arrays import BoolArray, FloatArray, IntArray, read_only_arrays
from dvf_ig.io import BeatAnnotations, read_annotations, read_ecg
from dvf_ig.report.style import ESTIMATE, SERIES, START, png_bytes
from dvf_ig.study.driver import Driver, Result, Rows, Study
from dvf_ig.study.options import option

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class GatingSettings:
    """Options of the study."""

    records: Path = option("Folder of WFDB records with annotations (.hea .dat .atr).")
    only: str | None = option("Records to use, separated by commas.", None)


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
    detected_s = np.array([peak.t_s for peak in peaks])
    order = np.argsort(detected_s, kind="stable")
    delays = np.array([peak.detected_at_s - peak.t_s for peak in peaks])[order]
    hits, partner = match_beats(detected_s[order], truth_s, 0.15)
    apart = np.abs(detected_s[order][partner] - truth_s[hits])
    return BeatScore(
        beats=len(truth_s),
        found=len(detected_s),
        hits_150=len(hits),
        hits_50=len(match_beats(detected_s[order], truth_s, 0.05)[0]),
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
    finite = np.isfinite(expected)
    expected, intervals = expected[finite], intervals[finite]
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


def risk_coverage(errors: PhaseErrors) -> tuple[FloatArray, FloatArray]:
    """Risk–coverage curve (El-Yaniv and Wiener 2010) of refusing by σφ alone, whatever the state.

    Returns:
        (k,) coverage: share of the time with σφ below a threshold; risk: p95 of |error| there in % of RR.
    """
    finite = np.isfinite(errors.sigma)
    order = np.argsort(errors.sigma[finite], kind="stable")
    error = np.abs(errors.error[finite][order])
    counts = np.unique(np.linspace(max(1, len(order) // 50), len(order), RISK_POINTS).astype(np.int64))
    p95 = np.array([100 * np.percentile(error[:count], 95) for count in counts])
    return counts / len(errors.error), p95


def summarise_study(scored: Sequence[RecordGating]) -> dict[str, Any]:
    """Summarise each record, beats pooled, phase and predictors by rhythm."""
    groups = {
        "all": list(scored),
        "held out": [r for r in scored if not r.tuning],
        "tuning": [r for r in scored if r.tuning],
    }
    phase, predictors = {}, {}
    for group, members in groups.items():
        for rhythm in RHYTHMS:
            chosen = [r for r in members if r.rhythm == rhythm]
            if chosen:
                phase[f"{rhythm}, {group}"] = summarise_phase([r.errors for r in chosen])
    for rhythm in RHYTHMS:
        chosen = [r for r in scored if r.rhythm == rhythm]
        for name in chosen[0].predictors if chosen else ():
            error = np.concatenate([r.predictors[name] for r in chosen])
            predictors[f"{name}, {rhythm}"] = {
                "mean_percent": float(100 * error.mean()),
                "p95_percent": float(100 * np.percentile(error, 95)),
            }
    return {
        "records": [_record(r) for r in scored],
        "beats": _pooled_beats(scored),
        "phase": phase,
        "predictors": predictors,
    }


def _record(scored: RecordGating) -> dict[str, Any]:
    beats = scored.beats
    return {
        "record": scored.name,
        "rhythm": scored.rhythm,
        "tuning": scored.tuning,
        **asdict(beats),
        **_rates(beats.hits_150, beats.hits_50, beats.beats, beats.found),
        "phase": asdict(scored.phase),
    }


def _rates(hits_150: int, hits_50: int, beats: int, detected: int) -> dict[str, float]:
    return {
        "se_150": hits_150 / beats,
        "ppv_150": hits_150 / max(detected, 1),
        "se_50": hits_50 / beats,
        "ppv_50": hits_50 / max(detected, 1),
    }


def _pooled_beats(scored: Sequence[RecordGating]) -> dict[str, float]:
    beats = [r.beats for r in scored]
    return {
        "beats": sum(b.beats for b in beats),
        **_rates(*(sum(getattr(b, n) for b in beats) for n in ("hits_150", "hits_50", "beats", "found"))),
        "median_timing_ms": float(np.median([b.timing_ms for b in beats])),
        "latency_p95_ms_max": max(b.latency_p95_ms for b in beats),
        "slowest_x_real_time": min(b.speed for b in beats),
    }


COLORS = {"sinus": ESTIMATE, "ectopic": START, "fibrillation": SERIES[3]}
TARGET_P95 = {"sinus": 8.0, "ectopic": 15.0}


def risk_coverage_figure(rhythms: Mapping[str, PhaseErrors]) -> Figure:
    """p95 error against the share of time kept, refusing by σφ; dots: where the clock is LOCKED."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 4.8), layout="constrained")
    axis = figure.subplots()
    for name, errors in rhythms.items():
        color = COLORS.get(name, "#444444")
        share, p95_percent = risk_coverage(errors)
        axis.plot(100 * share, p95_percent, color=color, lw=1.6, label=f"{name}: refused by σφ alone")
        locked = summarise_phase([errors])
        if not math.isnan(locked.p95_percent):
            place = (100 * locked.valid_share, locked.p95_percent)
            axis.plot(*place, "o", color=color, label=f"{name}: LOCKED by the clock")
        if name in TARGET_P95:
            axis.axhline(TARGET_P95[name], color=color, lw=0.8, ls=":")
    axis.set(
        xlabel="share of the time in which phase is used, % (dotted: the error aimed at)",
        ylabel="p95 of the phase error then, % of RR",
        xlim=(0, 100),
        ylim=(0, 50),
    )
    axis.grid(alpha=0.25, lw=0.5)
    figure.legend(fontsize=9, frameon=False, loc="outside lower center", ncols=max(1, len(rhythms)))
    return figure


def run(settings: GatingSettings, driver: Driver) -> Result:
    """Score every record."""
    names = _names(settings.records, settings.only)
    scored = []
    with driver.progress("records") as report:
        for k, name in enumerate(names):
            spec = f"wfdb:{settings.records / name}"
            scored.append(score_record(name, read_ecg(spec), read_annotations(spec)))
            report((k + 1) / len(names))
    summary = summarise_study(scored)
    files: dict[str, Any] = {"summary.json": summary}
    if driver.folder is not None:
        files["risk_coverage.png"] = png_bytes(risk_coverage_figure(_held_out(scored)), dpi=130)
    note: Rows = [("* the phase clock's limits were chosen on these records",), ("",)]
    return Result(summary["records"], [*_table(summary), *note, *_phase_table(summary)], files)


def _names(folder: Path, only: str | None) -> list[str]:
    there = sorted(path.stem for path in folder.glob("*.atr"))
    chosen = there if only is None else [name.strip() for name in only.split(",") if name.strip()]
    missing = [name for name in chosen if name not in there]
    if missing or not chosen:
        raise InvalidInputError(
            f"{folder} has no annotated record {', '.join(missing) or 'at all'}; "
            "needed NAME.hea, NAME.dat and NAME.atr in that folder"
        )
    return chosen


HEADER = (
    "record", "rhythm", "beats", "Se150", "PPV150", "Se50", "PPV50", "timing ms", "latency p95 ms",
    "x real time", "phase mean %", "p95 %", "valid %", "in 2σ %",
)  # fmt: skip


def _table(summary: dict[str, Any]) -> Rows:
    rows: Rows = [HEADER]
    for r in summary["records"]:
        times = (f"{r['timing_ms']:.1f}", f"{r['latency_p95_ms']:.0f}", f"{r['speed']:.0f}")
        name = r["record"] + ("*" if r["tuning"] else "")
        rows.append((name, r["rhythm"], str(r["beats"]), *_percents(r), *times, *_phase_cells(r["phase"])))
    pooled = summary["beats"]
    times = (
        f"{pooled['median_timing_ms']:.1f}",
        f"≤ {pooled['latency_p95_ms_max']:.0f}",
        f"≥ {pooled['slowest_x_real_time']:.0f}",
    )
    rows.append(("pooled", "", str(pooled["beats"]), *_percents(pooled), *times))
    return rows


def _percents(rates: dict[str, Any]) -> tuple[str, ...]:
    return tuple(f"{100 * rates[name]:.2f}" for name in ("se_150", "ppv_150", "se_50", "ppv_50"))


def _phase_table(summary: dict[str, Any]) -> Rows:
    head = ("phase error, % RR", "mean", "p95", "valid %", "in 2σ %", "fibrillation refused %")
    rows: Rows = [head]
    for name, phase in summary["phase"].items():
        share = phase.fibrillation_refused
        shown = "" if math.isnan(share) else f"{100 * share:.1f}"
        rows.append((name, *_phase_cells(asdict(phase)), shown))
    for name, error in summary["predictors"].items():
        mean, p95 = f"{error['mean_percent']:.2f}", f"{error['p95_percent']:.1f}"
        rows.append((f"predictor {name}", mean, p95, "all beats"))
    return rows


def _phase_cells(phase: dict[str, float]) -> tuple[str, str, str, str]:
    mean, p95 = phase["mean_percent"], phase["p95_percent"]
    return (
        "–" if math.isnan(mean) else f"{mean:.2f}",
        "–" if math.isnan(p95) else f"{p95:.1f}",
        f"{100 * phase['valid_share']:.1f}",
        "–" if math.isnan(mean) else f"{100 * phase['within_2_sigma']:.1f}",
    )


def _held_out(scored: Sequence[RecordGating]) -> dict[str, PhaseErrors]:
    """Errors of the held-out records of each rhythm; of all records if none is held out."""
    classes: dict[str, PhaseErrors] = {}
    for rhythm in RHYTHMS:
        chosen = [r.errors for r in scored if r.rhythm == rhythm and not r.tuning]
        if chosen:
            classes[rhythm] = pool(chosen)
    return classes or {"all": pool([r.errors for r in scored])}


STUDY = Study(
    GatingSettings,
    run,
    outputs=lambda _: ("summary.json", "risk_coverage.png"),
    trials=False,
    needs_folder=False,
)
