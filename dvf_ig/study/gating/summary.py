"""The gating study in one table: pooled over records, by rhythm, tuning records apart."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from .records import RHYTHMS, RecordGating, summarise_phase


def summarise_study(scored: Sequence[RecordGating]) -> dict[str, Any]:
    """What `summary.json` holds: each record, beats pooled, phase and predictors by rhythm."""
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


def _rates(hits_150: int, hits_50: int, beats: int, found: int) -> dict[str, float]:
    return {
        "se_150": hits_150 / beats,
        "ppv_150": hits_150 / max(found, 1),
        "se_50": hits_50 / beats,
        "ppv_50": hits_50 / max(found, 1),
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
