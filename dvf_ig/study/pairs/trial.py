"""One pair of organ images, registered from displaced starts, and against the MR of another patient.

Two families: simulated brains, one a seed, and hearts of real cines, whose ultrasound is simulated in another
way for every seed; there the patient is the unit of a claim.
"""

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from data_synth.organ_pair.pair import OrganPair, cine_pair, displaced_start, organ_pair
from data_synth.seeds import child_rng
from dvf_ig.core import Grid, Rigid, Volume
from dvf_ig.registration import register_pair
from dvf_ig.study.cines.patients import read_labelled_cine
from dvf_ig.study.trials import Line, Settings


class Family(StrEnum):
    """Where pairs come from."""

    brain = "brain"
    cardiac_mr = "cardiac-mr"


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
    if settings["family"] == Family.brain:
        return str(seed + further * OTHER_SEEDS)
    patients = settings["patients"]
    return str(patients[(seed + further) % len(patients)])


def _pair_of(settings: Settings, seed: int, further: int) -> OrganPair:
    if settings["family"] == Family.brain:
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
