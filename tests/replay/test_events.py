"""A recording as events: all of it, in order, and nothing of the truth."""

from types import SimpleNamespace

import numpy as np
import pytest

from dvf_ig.core import Landmarks, Points, PoseStream, Respiration, Signal, TrackedSequence
from dvf_ig.replay import events_of
from dvf_ig.session import EcgSamples, Landmark, RespirationSample, ToolPose, TrackedFrame


def stream(source: str, t_s: np.ndarray, lost: int) -> PoseStream:
    """A pose whose translation is its number; one was not tracked."""
    n = len(t_s)
    moved = np.column_stack([np.arange(n), np.zeros(n), np.zeros(n)]).astype(np.float64)
    return PoseStream("tracker", source, t_s, np.tile(np.eye(3), (n, 1, 1)), moved, np.arange(n) != lost)


def recording(**other: object) -> SimpleNamespace:
    """What the live part of a scenario holds; a look at anything else raises."""
    ecg = Signal(np.arange(500.0)[:, None], 250.0, 0.5, ("I",))
    us_s, tool_s = 0.4 + np.arange(20) / 10, np.arange(200) / 100
    images = np.arange(20, dtype=np.uint8)[:, None, None] * np.ones((1, 2, 3), dtype=np.uint8)
    probe = stream("probe", us_s, lost=4)
    ultrasound = TrackedSequence(us_s, images, np.arange(20) != 7, {probe.name: probe})
    given = {
        "ecg": ecg,
        "ultrasound": ultrasound,
        "tool": stream("tool", tool_s, lost=9),
        "landmarks_mr": None,
        "landmarks_tracker": None,
        "respiration": None,
    }
    return SimpleNamespace(**given | other)


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_every_sample_comes_once_and_in_order(chunk: int) -> None:
    events = list(events_of(recording(), ecg_chunk=chunk))
    due_s = [t_s for t_s, _ in events]
    assert due_s == sorted(due_s)
    ecg = [(t_s, e) for t_s, e in events if isinstance(e, EcgSamples)]
    np.testing.assert_array_equal(np.concatenate([e.samples[:, 0] for _, e in ecg]), np.arange(500.0))
    for t_s, e in ecg:
        assert t_s == e.start_s == 0.5 + e.samples[0, 0] / 250.0
    frames = [(t_s, e) for t_s, e in events if isinstance(e, TrackedFrame)]
    tool = [(t_s, e) for t_s, e in events if isinstance(e, ToolPose)]
    assert [e.t_s for _, e in frames] == (0.4 + np.arange(20) / 10).tolist()
    assert [e.t_s for _, e in tool] == (np.arange(200) / 100).tolist()
    assert all(t_s == e.t_s for t_s, e in frames + tool)
    assert len(ecg) + len(frames) + len(tool) == len(events)


def test_breathing_comes_sample_by_sample() -> None:
    breath = Respiration(0.2 + np.arange(9) / 10, np.arange(9.0)[:, None], "pressure")
    events = [e for _, e in events_of(recording(respiration=breath)) if isinstance(e, RespirationSample)]
    assert [(e.t_s, float(e.values[0])) for e in events] == list(
        zip(breath.t_s, breath.values[:, 0], strict=True)
    )


def test_what_was_not_recorded_as_valid_is_none() -> None:
    events = [e for _, e in events_of(recording())]
    frames = [e for e in events if isinstance(e, TrackedFrame)]
    tool = [e for e in events if isinstance(e, ToolPose)]
    assert [k for k, e in enumerate(frames) if e.image is None] == [7]
    assert [k for k, e in enumerate(frames) if e.tracker_from_probe is None] == [4]
    assert [k for k, e in enumerate(tool) if e.tracker_from_tool is None] == [9]
    assert [e.image[0, 0] for e in frames if e.image is not None] == [k for k in range(20) if k != 7]
    poses = [e.tracker_from_tool[0, 3] for e in tool if e.tracker_from_tool is not None]
    assert poses == [k for k in range(200) if k != 9]


def test_a_recording_without_images_has_poses_all_the_same() -> None:
    us_s = np.arange(5) / 10
    probe = stream("probe", us_s, lost=-1)
    blind = TrackedSequence(us_s, None, np.ones(5, dtype=bool), {probe.name: probe})
    frames = [e for _, e in events_of(recording(ultrasound=blind)) if isinstance(e, TrackedFrame)]
    assert all(e.image is None and e.tracker_from_probe is not None for e in frames)


def test_landmarks_were_touched_before_anything_else() -> None:
    mr = Landmarks(("a", "b", "only on the model"), Points("mr", np.eye(3)))
    tracker = Landmarks(("b", "a"), Points("tracker", 2.0 * np.eye(3)[:2]))
    events = list(events_of(recording(landmarks_mr=mr, landmarks_tracker=tracker)))
    touched = [e for _, e in events[:2]]
    assert all(isinstance(e, Landmark) for e in touched)
    assert not any(isinstance(e, Landmark) for _, e in events[2:])
    by_name = {e.name: e for e in touched if isinstance(e, Landmark)}
    assert set(by_name) == {"a", "b"}
    np.testing.assert_array_equal(by_name["a"].mr_mm, [1, 0, 0])
    np.testing.assert_array_equal(by_name["a"].tracker_mm, [0, 2, 0])
    assert all(t_s == e.t_s == 0.0 for t_s, e in events[:2] if isinstance(e, Landmark))
