"""What registration trials say together: accuracy, capture range, and whether a failure was known as one."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from dvf_ig.io import plain
from dvf_ig.study.share import Share, share_of
from dvf_ig.study.trials import Line

from .capture import Capture, capture_of
from .line import FAILURE_MM, STRICT_MM, SUCCESS_MM, error_of, number


@dataclass(frozen=True, slots=True)
class Spread:
    """Of `n` values; None where there is none, or where lost runs reach down to that percentile."""

    n: int
    median: float | None
    p95: float | None
    max: float | None


@dataclass(frozen=True, slots=True)
class SelfCheck:
    """Whether the method told failures from successes; None where it does not judge itself.

    Runs of 2 to 3 mm are neither success nor failure.

    Attributes:
        failures_flagged: failures that were not usable.
        successes_flagged: successes that were not usable.
        released_failures: usable runs that were failures: what would have reached the patient.
        auc: chance that a success has a higher success probability than a failure.
    """

    failures_flagged: Share | None
    successes_flagged: Share | None
    released_failures: Share | None
    auc: float | None


@dataclass(frozen=True, slots=True)
class Group:
    """The runs of one experiment, motion, quality, method and condition.

    Shares are of all `n` runs; a refused run, or one without a finite error, is no success. A run without a
    finite error is a failure larger than any other; refused ones have no error at all.

    Attributes:
        experiment: its letter; motion, quality, method, condition: empty where the lines do not say, as
            refused ones may not.
        pairs: image pairs seen.
        n: runs, with the `refused` ones among them.
        tre_mm: of all runs that were not refused, failures included.
        success_tre_mm: of the successes alone.
        success, strict, between, failure: below 2 mm; below 1 mm; 2 to 3 mm; above 3 mm.
        usable: runs that were released to guide by; None where the method does not judge itself.
        translation_mm: median size along each axis; None without.
    """

    experiment: str
    motion: str
    quality: str
    method: str
    condition: str
    pairs: int
    n: int
    refused: int
    tre_mm: Spread
    success_tre_mm: Spread
    rotation_deg: Spread
    translation_mm: tuple[float, float, float] | None
    success: Share
    strict: Share
    between: Share
    failure: Share
    capture: Capture
    seconds: Spread
    usable: Share | None
    check: SelfCheck


def summarise_trials(lines: Iterable[Line], *, up_to_mm: float | None = None) -> list[Group]:
    """A group for every experiment, motion, quality, method and condition, in the order of their first seeds.

    Args:
        lines: of trials.
        up_to_mm: only runs that start so near; a refused line without a start counts at every bound.
    Source: the area under the ROC is Mann and Whitney's U, ties count half.
    """
    groups: dict[tuple[str, ...], list[Line]] = {}
    for line in sorted(lines, key=lambda line: line["seed"]):
        start = number(line, "start_mm")
        if up_to_mm is None or math.isnan(start) or start <= up_to_mm + 1e-6:
            groups.setdefault(group_key(line), []).append(line)
    return [_group(key, runs) for key, runs in groups.items()]


def group_entry(group: Group) -> Line:
    """What `summary.json` holds of a group, where the experiment is called "arm"."""
    entry: Line = plain(group)
    return {"arm": entry.pop("experiment"), **entry}


def group_key(line: Line) -> tuple[str, ...]:
    """Experiment, motion, quality, method and condition; empty where the line does not say."""
    names = ("arm", "motion", "quality", "method", "condition")
    return tuple("" if line.get(name) is None else str(line[name]) for name in names)


def _group(key: tuple[str, ...], lines: Sequence[Line]) -> Group:
    experiment, motion, quality, method, condition = key
    errors = [error_of(line) for line in lines]

    def share(accepted: Callable[[float], bool]) -> Share:
        return share_of(sum(map(accepted, errors)), len(errors))

    return Group(
        experiment=experiment,
        motion=motion,
        quality=quality,
        method=method,
        condition=condition,
        pairs=len({line["pair"] for line in lines if line.get("pair") is not None}),
        n=len(lines),
        refused=sum("refused" in line for line in lines),
        tre_mm=_spread(errors),
        success_tre_mm=_spread([error for error in errors if error < SUCCESS_MM]),
        rotation_deg=_spread([number(line, "rotation_deg") for line in lines]),
        translation_mm=_translation(lines),
        success=share(lambda error: error < SUCCESS_MM),
        strict=share(lambda error: error < STRICT_MM),
        between=share(lambda error: SUCCESS_MM <= error <= FAILURE_MM),
        failure=share(lambda error: error > FAILURE_MM),
        capture=capture_of(lines),
        seconds=_spread([number(line, "seconds") for line in lines]),
        usable=_usable(lines),
        check=_self_check(lines),
    )


def _usable(lines: Sequence[Line]) -> Share | None:
    judged = [line["usable"] for line in lines if line.get("usable") is not None]
    return share_of(sum(judged), len(lines)) if judged else None


def _self_check(lines: Sequence[Line]) -> SelfCheck:
    failures = [line for line in lines if error_of(line) > FAILURE_MM]
    successes = [line for line in lines if error_of(line) < SUCCESS_MM]
    released = [line for line in lines if line.get("usable")]
    lost = sum(error_of(line) > FAILURE_MM for line in released)
    return SelfCheck(
        failures_flagged=_flagged(failures),
        successes_flagged=_flagged(successes),
        released_failures=share_of(lost, len(released)) if released else None,
        auc=auc_of(
            [number(line, "success_probability") for line in failures],
            [number(line, "success_probability") for line in successes],
        ),
    )


def _flagged(lines: Sequence[Line]) -> Share | None:
    said = [bool(line["usable"]) for line in lines if line.get("usable") is not None]
    return share_of(len(said) - sum(said), len(said)) if said else None


def auc_of(failures: Sequence[float], successes: Sequence[float]) -> float | None:
    """Chance that a success has the higher value, ties half; NaN values are left out."""
    bad = np.array([p for p in failures if math.isfinite(p)])
    good = np.array([p for p in successes if math.isfinite(p)])
    if len(bad) == 0 or len(good) == 0:
        return None
    ranks = rankdata(np.concatenate([good, bad]))[: len(good)]
    return float((ranks.sum() - len(good) * (len(good) + 1) / 2) / (len(good) * len(bad)))


def _translation(lines: Sequence[Line]) -> tuple[float, float, float] | None:
    shifts = [line["translation_mm"] for line in lines if line.get("translation_mm") is not None]
    whole = np.array([shift for shift in shifts if None not in shift], dtype=np.float64)
    if len(whole) == 0:
        return None
    x, y, z = np.median(np.abs(whole), axis=0)
    return float(x), float(y), float(z)


def _spread(values: Iterable[float]) -> Spread:
    """NaN values are left out; infinite ones count, but are reported as None."""
    known = sorted(value for value in values if not math.isnan(value))
    return Spread(len(known), _percentile(known, 50), _percentile(known, 95), _percentile(known, 100))


def _percentile(ordered: Sequence[float], percent: float) -> float | None:
    """As np.percentile, which makes NaN of infinite values even where it needs none of them."""
    if not ordered:
        return None
    place = (len(ordered) - 1) * percent / 100
    low = math.floor(place)
    value = ordered[low]
    if place > low:
        value += (place - low) * (ordered[low + 1] - ordered[low])
    return value if math.isfinite(value) else None
