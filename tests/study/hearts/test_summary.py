"""The figures of many hearts: one vote a heart, and intervals over hearts."""

from typing import Any

import numpy as np
import pytest

from dvf_ig.study.hearts.summary import WALLS, hearts_table, summarise_hearts
from dvf_ig.study.statistics import bootstrap, calibration_error, calibration_error_by_chance


def line(heart: int, tre_mm: float, **more: Any) -> dict[str, Any]:
    return {
        "heart": heart,
        "world": "first",
        "images": "sweep",
        "quality": "calm",
        "disturbed": False,
        "tre_mm": tre_mm,
        "tre_p95_mm": 1.5 * tre_mm,
        "tre_max_mm": 2.0 * tre_mm,
        "tre_bound_mm": 2.5,
        "chi2": 6.0,
        "usable": tre_mm < 2.5,
        "success_probability": 0.9 if tre_mm < 2.5 else 0.1,
        "seconds": 1.0,
        **more,
    }


def test_a_heart_without_a_result_is_no_success() -> None:
    (group,) = summarise_hearts(
        [line(1, 0.5), line(2, 0.7), {**line(3, 0.0), "refused": "too few frames passed the gate"}]
    )
    assert (group.hearts, group.failed) == (3, 1)
    assert (group.success.count, group.success.of) == (2, 3)
    assert group.tre_median_mm.value == pytest.approx(0.6)


def test_refusals_are_counted_of_bad_and_of_good_poses_apart() -> None:
    (group,) = summarise_hearts([line(1, 1.0), line(2, 1.2, usable=False), line(3, 2.5), line(4, 6.0)])
    assert (group.good_refused.count, group.good_refused.of) == (1, 2)
    assert (group.bad_refused.count, group.bad_refused.of) == (1, 1)
    assert (group.bound_covers.count, group.bound_covers.of) == (2, 4)
    assert group.auc == 1.0


def test_bounds_of_hearts_that_are_covered_in_part_refer_to_that_part() -> None:
    part = {"covered_mm": 1.0, "covered_max_mm": 2.4}
    (group,) = summarise_hearts([line(1, 2.2, **part), line(2, 2.3, **part, tre_bound_mm=2.3)])
    assert (group.bound_covers.count, group.bound_covers.of) == (1, 2)
    assert (group.covered_success.count, group.success.count) == (2, 0)
    assert group.covered_median_mm.value == pytest.approx(1.0)


def test_a_pose_outside_what_was_calibrated_has_no_probability_and_is_counted() -> None:
    (group,) = summarise_hearts([line(1, 1.0), line(2, 1.0, success_probability=None, tre_bound_mm=None)])
    assert group.outside == 1
    assert group.bound_covers.of == 1


WALL_ERRORS: dict[str, Any] = {**dict.fromkeys(WALLS, 1.0), "outward_mm": [1.0], "sigma_mm": [1.0]}


def test_margins_that_know_where_the_wall_is_uncertain_leave_less_of_violations() -> None:
    walls = {**WALL_ERRORS, "outward_mm": [0.5, 2.0], "sigma_mm": [0.5, 1.5], "followed": True}
    (group,) = summarise_hearts([line(heart, 1.0, change="5mm", walls=walls) for heart in range(3)])
    assert group.margins is not None
    assert group.margins.mean_mm == pytest.approx(1.0)
    assert (group.margins.without_mm, group.margins.fixed_mm) == (2.0, 1.0)
    assert group.margins.adaptive_mm == pytest.approx(0.5)


def test_walls_of_changed_hearts_have_groups_of_their_own() -> None:
    walls = {**WALL_ERRORS, "followed": True}
    rigid = {**walls, "followed": False, "seen_mm": 2.0, "seen_per_sigma": None, "unseen_per_sigma": None}
    changed = [
        line(1, 1.0, change="5mm", walls=walls),
        line(2, 3.0, change="5mm", walls=rigid),
        {**line(3, 0.0, change="5mm"), "refused": "too few frames passed the gate"},
    ]
    plain, group = summarise_hearts([line(1, 1.0), *changed])
    assert (plain.change, plain.walls["seen_mm"].value) == (None, None)
    assert (group.used.count, group.used.of) == (1, 3)
    assert (group.followed.count, group.followed.of) == (1, 2)
    assert (group.walls["seen_mm"].value, group.walls["seen_per_sigma"].value) == (1.5, 1.0)
    rows = hearts_table([plain, group])
    assert rows[0] == ("", "sweep, calm", "sweep, calm, 5mm")
    assert "followed" in {row[0] for row in rows}
    assert "followed" not in {row[0] for row in hearts_table([plain])}


def test_what_no_rigid_pose_removes_is_told_where_it_is_known() -> None:
    (known,) = summarise_hearts([line(1, 1.0, floor_mm=0.4), line(2, 1.2, floor_mm=0.6)])
    assert known.floor_median_mm.value == pytest.approx(0.5)
    (unknown,) = summarise_hearts([line(1, 1.0, floor_mm=None)])
    assert unknown.floor_median_mm.value is None


def test_trials_of_one_heart_count_once_in_an_interval() -> None:
    (apart,) = summarise_hearts([line(heart, 1.0 + heart % 2) for heart in range(20)])
    (together,) = summarise_hearts([line(heart // 4, 1.0 + heart // 4 % 2) for heart in range(20)])
    assert (apart.hearts, together.hearts, together.trials) == (20, 5, 20)

    def width(of: Any) -> float:
        return float(of.high - of.low)

    assert width(together.tre_median_mm) >= width(apart.tre_median_mm)
    assert width(together.success) > 1.5 * width(apart.success)


def test_groups_are_told_apart() -> None:
    groups = summarise_hearts([line(1, 1.0), line(2, 1.0, quality="poor-image"), line(3, 1.0)])
    assert [(group.quality, group.hearts) for group in groups] == [("calm", 2), ("poor-image", 1)]


def test_the_bootstrap_interval_of_a_mean_is_that_of_theory() -> None:
    values = np.random.default_rng(1).normal(2.0, 1.0, 400).tolist()
    found = bootstrap(values, np.mean)
    assert found.value is not None
    half = 1.96 * np.std(values) / np.sqrt(400)
    assert found.low == pytest.approx(found.value - half, abs=0.02)
    assert found.high == pytest.approx(found.value + half, abs=0.02)


def test_too_few_hearts_have_no_interval() -> None:
    assert bootstrap([1.5], np.median).low is None
    assert bootstrap([], np.median).value is None


def test_calibration_error_is_the_mean_gap_between_stated_and_seen() -> None:
    assert calibration_error([0.85] * 10, [True] * 8 + [False] * 2) == pytest.approx(0.05)
    assert calibration_error([1.0, 0.0], [True, False]) == 0.0
    assert calibration_error([], []) is None


def test_few_trials_show_a_calibration_error_where_there_is_none() -> None:
    # |x| of x ~ N(0, p(1 − p)/n) is √(2/π) of its standard deviation on average
    assert calibration_error_by_chance([0.85] * 400) == pytest.approx(
        np.sqrt(2 / np.pi * 0.85 * 0.15 / 400), rel=0.05
    )
    assert calibration_error_by_chance([1.0, 0.0]) == 0.0
    assert calibration_error_by_chance([]) is None
