"""What trials on pairs say together; the unit is the pair, one run of each in every group."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.study.registration.line import FAILURE_MM, SUCCESS_MM
from dvf_ig.study.share import Share, share_of
from dvf_ig.study.trials import Line

from .trial import OWN


@dataclass(frozen=True, slots=True)
class PairGroup:
    """Runs of one kind, one a pair.

    Attributes:
        patient: whose MR; contrasts: of it; start_mm: mean error of the starts.
        success: mean error at the landmarks below SUCCESS_MM.
        error_median_mm, error_p95_mm: over pairs; None of another patient's.
        good_refused: of poses below SUCCESS_MM; bad_refused: of those above FAILURE_MM, and of all of another
            patient's.
        cpu_seconds_median: of one run, on all threads together.
    """

    patient: str
    contrasts: str
    start_mm: float
    success: Share
    error_median_mm: float | None
    error_p95_mm: float | None
    good_refused: Share
    bad_refused: Share
    cpu_seconds_median: float


def summarise_pairs(lines: Sequence[Line]) -> list[PairGroup]:
    """A group for each kind of run, in the order in which a pair's runs were made."""
    groups: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for line in lines:
        for run in line.get("runs", []):
            groups.setdefault((run["patient"], run["contrasts"], run["start_mm"]), []).append(run)
    return [_group(*kind, runs) for kind, runs in groups.items()]


def _group(patient: str, contrasts: str, start_mm: float, runs: Sequence[dict[str, Any]]) -> PairGroup:
    errors = [float("inf") if run["error_mm"] is None else float(run["error_mm"]) for run in runs]
    good = [run for run, error in zip(runs, errors, strict=True) if error < SUCCESS_MM]
    bad = [run for run, error in zip(runs, errors, strict=True) if error > FAILURE_MM]
    own = patient == OWN
    return PairGroup(
        patient,
        contrasts,
        start_mm,
        share_of(len(good), len(runs) if own else 0),
        float(np.median(errors)) if own else None,
        float(np.percentile(errors, 95)) if own else None,
        _refused(good),
        _refused(bad),
        float(np.median([run["cpu_seconds"] for run in runs])),
    )


def _refused(runs: Sequence[dict[str, Any]]) -> Share:
    return share_of(sum(not run["usable"] for run in runs), len(runs))
