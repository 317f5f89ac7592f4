"""Hearts that something was tuned on are never reported."""

import pytest

from dvf_ig.core import InvalidInputError
from dvf_ig.study.hearts.recordings import HEART_LISTS, REPORTED, heart_list


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
