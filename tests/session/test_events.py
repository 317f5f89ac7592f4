"""Events own what they hold, and refuse what no source can mean."""

from collections.abc import Callable

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError
from dvf_ig.session import EcgSamples, Landmark, Rearm, ToolPose, TrackedFrame

IMAGE = np.zeros((2, 3), dtype=np.uint8)


@pytest.mark.parametrize("t_s", [float("nan"), float("inf"), -float("inf")])
def test_a_stamp_that_is_no_time_is_refused(t_s: float) -> None:
    makers = (
        lambda: EcgSamples(t_s, np.zeros((1, 1))),
        lambda: TrackedFrame(t_s, IMAGE, np.eye(4)),
        lambda: ToolPose(t_s, np.eye(4)),
        lambda: Landmark(t_s, "apex", np.zeros(3), np.zeros(3)),
        lambda: Rearm(t_s),
    )
    for make in makers:
        with pytest.raises(InvalidInputError, match=f"stamped {t_s} s; needed a finite time"):
            make()


def test_an_event_keeps_what_it_was_given_when_the_buffer_is_used_again() -> None:
    samples, image, pose, point = np.ones((2, 1)), IMAGE + 7, np.eye(4), np.ones(3)
    events = (
        EcgSamples(0.0, samples).samples,
        TrackedFrame(0.0, image, pose).image,
        TrackedFrame(0.0, image, pose).tracker_from_probe,
        ToolPose(0.0, pose).tracker_from_tool,
        Landmark(0.0, "apex", point, point).mr_mm,
    )
    before = [None if e is None else e.copy() for e in events]
    for given in (samples, image, pose, point):
        given[...] = 0
    for event, was in zip(events, before, strict=True):
        assert event is not None
        np.testing.assert_array_equal(event, was)
        assert not event.flags.writeable


def test_what_is_not_tracked_and_what_is_missing_is_let_in() -> None:
    """The session judges it: refusing it here would hide that the source is broken."""
    assert TrackedFrame(0.0, None, None).image is None
    assert ToolPose(0.0, None).tracker_from_tool is None
    broken = ToolPose(0.0, np.full((4, 4), np.nan)).tracker_from_tool
    assert broken is not None
    assert np.isnan(broken).all()
    assert np.isnan(EcgSamples(0.0, [[np.nan]]).samples).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: EcgSamples(0.0, np.zeros(5)), r"ECG samples has shape \(5,\); needed \(n, n\)"),
        (lambda: ToolPose(0.0, np.eye(3)), r"tracker_from_tool has shape \(3, 3\); needed \(4, 4\)"),
        (lambda: ToolPose(0.0, [[1.0, 0.0]]), r"tracker_from_tool has shape \(1, 2\); needed \(4, 4\)"),
        (lambda: TrackedFrame(0.0, IMAGE, np.eye(3)), r"tracker_from_probe has shape \(3, 3\)"),
        (lambda: TrackedFrame(0.0, IMAGE.astype(float), np.eye(4)), "float64; needed .* uint8"),
        (lambda: TrackedFrame(0.0, np.zeros((2, 3, 3), np.uint8), np.eye(4)), r"shape \(2, 3, 3\)"),
        (lambda: Landmark(0.0, "apex", np.zeros(2), np.zeros(3)), r"mr_mm has shape \(2,\)"),
        (lambda: Landmark(0.0, "apex", np.zeros(3), np.full(3, np.nan)), "tracker_mm has 3 non-finite"),
    ],
)
def test_what_has_another_shape_is_refused_in_a_sentence(make, message) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ToolPose(1e11, None), r"stamp of a tool pose, s, reaches 1e\+11; needed at most 1e\+10"),
        (lambda: TrackedFrame(-1e300, None, None), r"stamp of a tracked frame, s, reaches 1e\+300"),
        (lambda: EcgSamples(0.0, [[0.1], [1e200]]), r"an ECG sample reaches 1e\+200; needed at most 1e\+09"),
        (lambda: Landmark(0.0, "apex", np.zeros(3), np.full(3, 1e9)), r"landmark tracker_mm reaches 1e\+09"),
        (lambda: ToolPose(0.0, np.diag([1.0, 1.0, 1.0, 1e9])), r"tracker_from_tool, mm, reaches 1e\+09"),
        (lambda: TrackedFrame(0.0, None, np.full((4, 4), 1e9)), r"tracker_from_probe, mm, reaches 1e\+09"),
    ],
)
def test_numbers_that_nothing_in_an_operating_room_has_are_refused(
    make: Callable[[], object], message: str
) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make()
