"""What a result says of the tool in the images."""

from types import SimpleNamespace
from typing import Any

from dvf_ig.registration import TipSighting
from dvf_ig.replay.result.pose import tip_field
from dvf_ig.session import SessionHistory


def replay_of(*off_mm: float) -> Any:
    history = SessionHistory()
    for off in off_mm:
        history.append(TipSighting(off, 2.0, 90.0, 5.0, 8))
    return SimpleNamespace(history=history)


def test_a_tool_that_was_never_seen_is_told_as_nothing() -> None:
    assert tip_field(replay_of()) is None


def test_the_last_sighting_and_the_longest_row_elsewhere_are_told() -> None:
    told = tip_field(replay_of(0.5, 5.0, 5.0, 0.0, 4.0, 4.0, 4.5, 1.0))
    assert told == {
        "off_mm": 1.0,
        "beside_mm": 2.0,
        "contrast_grey": 90.0,
        "ratio": 5.0,
        "seen_beats": 8,
        "elsewhere_beats": 3,
    }
    never = tip_field(replay_of(0.5))
    assert never is not None
    assert never["elsewhere_beats"] == 0
