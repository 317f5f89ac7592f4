"""One pair of organ images, registered from displaced starts, and against the MR of another patient."""

from collections.abc import Iterator
from time import perf_counter, process_time
from typing import Any

import numpy as np

from data_synth.organ_pair.pair import OrganPair, displaced_start, organ_pair
from data_synth.seeds import child_rng
from dvf_ig.core import Rigid
from dvf_ig.registration import register_pair
from dvf_ig.study.trials import Line, Settings

OWN, OTHER = "own", "another patient"
OTHER_SEEDS = 500_000
"""Added to a pair's seed for the patient whose MR is not this one's."""


def pair_trial(settings: Settings, seed: int) -> Line:
    """Every run on one pair: each choice of contrasts from each start, and once against another patient.

    Args:
        settings: `contrasts`, names joined by "+"; `starts_mm`, mean errors of the starts.
    """
    pair = organ_pair(seed)
    return {
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
    other = organ_pair(seed + OTHER_SEEDS)
    start = same_view(other, pair)
    yield from ((other, names, start, 0.0) for names in settings["contrasts"])


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
        "mirrored_share": evidence.mirrored_share,
        "seconds": result.seconds,
        "cpu_seconds": process_time() - cpu_s,
    }
