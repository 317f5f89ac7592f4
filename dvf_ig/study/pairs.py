"""Register ultrasound and MR of simulated brains from 4 and 8 mm, and against another patient's MR.

With --cines the MR is real and the ultrasound simulated from it; patients take turns with the seeds, and are
the unit of a claim. Seeds 1001–1999 are for tuning, 3001 and on for what is reported. Intervals are Wilson's
over pairs.

    dvf-ig study pairs --seeds 6 -o study
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from data_synth.organ_pair.mr import CONTRASTS
from data_synth.organ_pair.pair import OrganPair, cine_pair, displaced_start, organ_pair
from data_synth.seeds import child_rng
from dvf_ig.core import Grid, InvalidInputError, Rigid, Volume
from dvf_ig.registration import register_pair
from dvf_ig.study.cines import VOXEL_HELP, labelled_cines, read_labelled_cine
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials
from dvf_ig.study.options import option, seed_option, seeds_option
from dvf_ig.study.statistics import FAILURE_MM, SUCCESS_MM, Share, number_text, share_of, share_text

STARTS_MM = [4.0, 8.0]


@dataclass(frozen=True, kw_only=True)
class PairsSettings:
    """Options of the study."""

    seeds: int = seeds_option(20)
    seed: int = seed_option(3001)
    contrasts: tuple[str, ...] = option(
        "Of brains: t1, flair, t2 or several joined by +; may be given again.", ()
    )
    cines: Path | None = option(
        "Instead of brains: real MR at end-diastole of the cines in this folder.", None
    )
    patients: str | None = option("Only folders that end so: 002,003 (default: all).", None)
    voxel_mm: tuple[float, float, float] | None = option(VOXEL_HELP, None)


@dataclass(frozen=True, slots=True)
class PairGroup:
    """Runs of one kind, one a pair.

    Attributes:
        patient: whose MR; contrasts: of it; start_mm: mean error of the starts.
        success: mean error at the landmarks below SUCCESS_MM.
        error_median_mm, error_p95_mm: over pairs; None for another patient's.
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


OWN, OTHER = "own", "another patient"
OTHER_SEEDS = 500_000
"""Added to a pair's seed for the patient whose MR is not this one's."""


def pair_trial(settings: Settings, seed: int) -> Line:
    """Every run on one pair: each choice of contrasts from each start, and once against another patient.

    Args:
        settings: `family`; `contrasts`, names joined by "+"; `starts_mm`, mean errors of the starts; of cines
            `patients`, folders, and `voxel_mm`, of those whose header has lost it.
    """
    pair = _pair_of(settings, seed, 0)
    return {
        "patient": _patient(settings, seed, 0),
        "floor_mm": pair.error_mm(pair.moving_from_fixed),
        "runs": [
            _run(pair, patient, names, start, start_mm, seed)
            for patient, names, start, start_mm in _conditions(settings, pair, seed)
        ],
    }


def _conditions(
    settings: Settings, pair: OrganPair, seed: int
) -> Iterator[tuple[OrganPair, str, Rigid, float]]:
    rng = child_rng(seed, "pair starts")
    for start_mm in settings["starts_mm"]:
        start = displaced_start(pair, start_mm, rng)
        yield from ((pair, names, start, start_mm) for names in settings["contrasts"])
    other = _pair_of(settings, seed, 1)
    start = same_view(other, pair)
    yield from ((other, names, start, 0.0) for names in settings["contrasts"])


def _patient(settings: Settings, seed: int, further: int) -> str:
    """Whose pair a seed's is; the cines take turns. `further` 1: the patient taken for another."""
    if settings["family"] == "brain":
        return str(seed + further * OTHER_SEEDS)
    patients = settings["patients"]
    return str(patients[(seed + further) % len(patients)])


def _pair_of(settings: Settings, seed: int, further: int) -> OrganPair:
    if settings["family"] == "brain":
        return organ_pair(seed + further * OTHER_SEEDS)
    folder = Path(_patient(settings, seed, further))
    return cine_pair(end_diastole(folder, settings["voxel_mm"]), seed + further * OTHER_SEEDS)


def end_diastole(folder: Path, voxel_mm: tuple[float, float, float] | None) -> Volume:
    """The real grey levels of a patient's cine at end-diastole, frame "moving"."""
    cine = read_labelled_cine(folder, voxel_mm)
    grid = cine.image.grid
    moved = Grid("moving", grid.shape, grid.origin_mm, grid.spacing_mm, grid.direction)
    return Volume(moved, cine.image.values[cine.ed_phase])


def same_view(other: OrganPair, pair: OrganPair) -> Rigid:
    """A pose at which the ultrasound of `pair` looks at another patient as that one's own did."""
    turn = other.fixed.grid.direction @ pair.fixed.grid.direction.T
    rotation = other.moving_from_fixed.rotation @ turn
    shift = other.moving_mm.mean(axis=0) - rotation @ pair.fixed_mm.mean(axis=0)
    return Rigid("moving", "fixed", rotation, shift)


def _run(
    pair: OrganPair, patient: OrganPair, names: str, start: Rigid, start_mm: float, seed: int
) -> dict[str, Any]:
    moving = [patient.moving[name] for name in names.split("+")]
    cpu_s = process_time()
    result = register_pair(pair.fixed, moving, start, rng=np.random.default_rng(seed), clock=perf_counter)
    evidence = result.evidence.pair
    if evidence is None:
        raise TypeError("a pair's result holds no evidence of a pair")
    own = patient is pair
    return {
        "patient": OWN if own else OTHER,
        "contrasts": names,
        "start_mm": start_mm,
        "error_mm": pair.error_mm(result.target_from_source) if own else None,
        "usable": result.stop.usable,
        "stop": result.stop.name,
        "success_probability": result.success_probability,
        "similarity": result.similarity,
        "agreeing_starts": evidence.agreeing_starts,
        "next_best_share": evidence.next_best_share,
        "jackknife_mm": evidence.jackknife_mm,
        "halves_mm": evidence.halves_mm,
        "z_score": evidence.z_score,
        "mirrored_share": evidence.mirrored_share,
        "seconds": result.seconds,
        "cpu_seconds": process_time() - cpu_s,
    }


def run(settings: PairsSettings, driver: Driver) -> Result:
    """Register every seed's pair."""
    fields = {**_trial_settings(settings), "starts_mm": STARTS_MM}
    seeds = range(settings.seed, settings.seed + settings.seeds)
    lines = driver.trials(Trials("pairs", fields, pair_trial), seeds)
    groups = summarise_pairs(lines)
    summary = {"seed": settings.seed, "seeds": settings.seeds, **fields, "groups": groups}
    return Result(summary, _table(groups), {"summary.json": summary})


def _trial_settings(settings: PairsSettings) -> Settings:
    """The family of pairs, its contrasts and, for real MR, its patients.

    Raises:
        InvalidInputError: options of the other family, a contrast that is not simulated, or one patient.
    """
    if settings.cines is None:
        if settings.patients is not None or settings.voxel_mm is not None:
            raise InvalidInputError("--patients and --voxel-mm are of cines; give --cines FOLDER")
        fields: Settings = {
            "family": "brain",
            "contrasts": list(settings.contrasts) or ["t1", "flair", "t1+flair"],
        }
        available = set(CONTRASTS)
    else:
        folders = labelled_cines(settings.cines, tuple((settings.patients or "").split(",")))
        if len(folders) < 2:
            raise InvalidInputError("one patient; needed two, so that one can be taken for the other")
        fields = {
            "family": "cardiac-mr",
            "contrasts": list(settings.contrasts) or ["cine"],
            "patients": [str(path.resolve()) for path in folders],
            "voxel_mm": settings.voxel_mm,
        }
        available = {"cine"}
    unknown = {name for names in fields["contrasts"] for name in names.split("+")} - available
    if unknown:
        raise InvalidInputError(
            f"contrast '{min(unknown)}' is not simulated; choose {', '.join(sorted(available))}"
        )
    return fields


def _table(groups: Sequence[PairGroup]) -> Rows:
    head = ("MR", "contrasts", "start mm", "below 2 mm", "median mm", "p95 mm", "good refused", "bad refused")
    rows: Rows = [(*head, "CPU s")]
    for g in groups:
        start = f"{g.start_mm:g}" if g.start_mm else "–"
        errors = (number_text(g.error_median_mm), number_text(g.error_p95_mm))
        shares = (share_text(g.good_refused), share_text(g.bad_refused))
        seconds = f"{g.cpu_seconds_median:.1f}"
        rows.append((g.patient, g.contrasts, start, share_text(g.success), *errors, *shares, seconds))
    return rows


STUDY = Study(PairsSettings, run)
