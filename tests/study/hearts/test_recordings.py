"""Hearts that something was tuned on are never reported; a start has exactly the error that was asked for."""

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_pose

from dvf_ig.core import InvalidInputError, Points
from dvf_ig.registration import pose_difference, target_errors_mm
from dvf_ig.study.hearts.recordings import HEART_LISTS, REPORTED, Truth, heart_list, start_with_error

TARGETS = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-45, 45, (27, 3)))
KNOWN = Truth(toy_pose(), TARGETS, CENTER_MM)


def test_no_heart_is_in_two_lists() -> None:
    lists = list(HEART_LISTS.values())
    for hearts in ("first_world", "second_world", "patients"):
        named = [heart for one in lists for heart in getattr(one, hearts)]
        assert len(named) == len(set(named))


def test_the_second_world_is_for_reporting_alone() -> None:
    assert len(REPORTED.second_world) >= 40
    assert not any(one.second_world for one in HEART_LISTS.values() if one is not REPORTED)


def test_an_unknown_list_is_refused_by_name() -> None:
    with pytest.raises(InvalidInputError, match="'secret'; choose from tuning, threshold, reported"):
        heart_list("secret")


def test_hearts_of_the_second_world_are_reported_alone() -> None:
    assert REPORTED.of_world("second") == REPORTED.second_world
    with pytest.raises(InvalidInputError, match="no hearts of the second world"):
        heart_list("tuning").of_world("second")


@pytest.mark.parametrize("start_mm", [0.5, 2.0, 8.0, 20.0, 90.0])
def test_a_start_has_exactly_the_mean_error_asked_for(start_mm: float) -> None:
    starts = [start_with_error(KNOWN, start_mm, np.random.default_rng(seed)) for seed in range(40)]
    errors = [target_errors_mm(start, toy_pose(), TARGETS).mean() for start in starts]
    np.testing.assert_allclose(errors, start_mm, rtol=1e-9)
    turns, shifts = zip(*(pose_difference(s, toy_pose(), CENTER_MM) for s in starts), strict=True)
    lengths = np.linalg.norm(np.array(shifts), axis=1)
    # some are nearly all rotation, some nearly all shift, and no two are equal
    assert max(turns) <= 180.0
    assert lengths.min() < 0.5 * start_mm
    assert lengths.max() > 0.9 * start_mm
    assert len({s.matrix.tobytes() for s in starts}) == len(starts)


def test_a_start_may_be_the_truth() -> None:
    at_truth = start_with_error(KNOWN, 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(at_truth.matrix, toy_pose().matrix, atol=1e-9)
