"""The replay study: which trial is which, and what a preset's replays say together."""

from dataclasses import asdict
from typing import Any

import pytest

from data_synth.scenario.presets import PRESETS
from dvf_ig.study.replay import PartScore, summarise_replays, trial_numbers, trial_of


def line(number: int, tre_mm: float | None, hazard_s: float) -> dict[str, Any]:
    return {
        "seed": number,
        "scenario_seed": number // 2,
        "tre_mm": None if tre_mm is None else {"median": tre_mm},
        "force_error_n": None if tre_mm is None else {"median": 0.1 * tre_mm},
        "contact": {"served_share": 0.5, "served_known_share": 0.9},
        "surface_error_mm": None
        if tre_mm is None
        else {"rms": 0.5 * tre_mm, "force_far_off_s": 0.2 * hazard_s},
        "hazard_s": hazard_s,
        "hazard_longest_s": hazard_s / 2,
        "withheld_s": 3.0,
        "valid_ticks": 800,
        "ticks": 1000,
        "supervisor": {"latched_s": 0.0},
        "tip_in_image": None,
        "pose_bound_mm": None
        if tre_mm is None
        else {"median": 2.0 * tre_mm, "updates": 20, "coverage": 0.95},
        "settled": None if tre_mm is None else asdict(PartScore(tre_mm, 2 * tre_mm, 0.9, 0.95, 1.0)),
        "gate": None,
    }


def test_the_trials_of_one_seed_follow_one_another() -> None:
    kinds = [(preset, None) for preset in PRESETS]
    numbers = trial_numbers(len(kinds), first_seed=7, seeds=2)
    asked = [trial_of({"kinds": kinds}, number) for number in numbers]
    assert asked == [(seed, kind) for seed in (7, 8) for kind in kinds]


def test_the_worst_seed_gives_the_hazard_and_the_median_the_error() -> None:
    lines = [line(4, 1.0, 0.0), line(6, 3.0, 4.0), line(8, None, 0.0), {"seed": 10, "refused": "no"}]
    (calm, other) = summarise_replays(lines, [("calm", None), ("ectopy", None)])
    assert (calm.seeds, calm.refused, calm.guided) == (4, 1, 2)
    assert (calm.tre_median_mm, calm.tre_worst_mm) == (2.0, 3.0)
    assert (calm.hazard_s, calm.hazard_longest_s) == (4.0, 2.0)
    assert (calm.wall_rms_mm, calm.wall_far_off_s) == (1.0, 0.8)
    assert calm.valid_share == 0.8
    assert (calm.pose_updates, calm.pose_bound_mm) == (40, 4.0)
    assert calm.pose_bound_covers.value == 0.95
    assert calm.settled == PartScore(2.0, 4.0, 0.9, 0.95, 1.0)
    assert (calm.settled_p95_worst_mm, other.settled) == (6.0, None)
    assert (other.seeds, other.hazard_s) == (0, None)


def test_a_breathing_heart_is_compared_with_the_same_seed_without_breathing() -> None:
    lines = [line(4, 1.0, 0.0), line(5, 1.4, 0.0), line(6, 2.0, 0.0), line(7, 2.6, 0.0)]
    lines[1]["gate"] = asdict(PartScore(0.6, 1.2, 0.3, 0.9, 1.0))
    calm, ventilated = summarise_replays(lines, [("calm", None), ("ventilated", None)])
    assert ventilated.over_calm == pytest.approx(1.35)
    assert ventilated.gate == PartScore(0.6, 1.2, 0.3, 0.9, 1.0)
    assert (ventilated.gate_p95_worst_mm, calm.gate) == (1.2, None)
