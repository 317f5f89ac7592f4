"""When a replay begins and ends, and what it refuses."""

from types import SimpleNamespace

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError, NoOverlapError, PoseStream, Signal, TrackedSequence
from dvf_ig.replay.preconditions import require_heart_beats, require_tracked_poses, tick_times


def stream(source: str, begin_s: float, end_s: float, *, tracked: bool = True) -> PoseStream:
    t_s = np.linspace(begin_s, end_s, 50)
    return PoseStream(
        "tracker", source, t_s, np.tile(np.eye(3), (50, 1, 1)), np.zeros((50, 3)), np.full(50, tracked)
    )


def recorded(
    ecg: tuple[float, float] = (0.0, 20.0),
    tool: tuple[float, float] = (1.0, 20.0),
    probe: tuple[float, float] = (0.5, 20.0),
    **tracked: bool,
) -> SimpleNamespace:
    samples = np.zeros((round(250 * (ecg[1] - ecg[0])) + 1, 1))
    seen = stream("probe", *probe, tracked=tracked.get("probe_tracked", True))
    return SimpleNamespace(
        ecg=Signal(samples, 250.0, ecg[0], ("II",)),
        tool=stream("tool", *tool, tracked=tracked.get("tool_tracked", True)),
        ultrasound=TrackedSequence(seen.t_s, None, np.ones(50, dtype=bool), {seen.name: seen}),
    )


@pytest.mark.parametrize(
    ("scenario", "begin_s", "end_s"),
    [
        (recorded(), 1.0, 20.0),
        (recorded(tool=(1.0, 7.0)), 1.0, 20.0),  # a tool that was put down ends nothing: it is lost
        (recorded(probe=(0.5, 7.0)), 1.0, 20.0),
        (recorded(tool=(1.0, 7.0), probe=(0.5, 9.0)), 1.0, 9.0),
        (recorded(ecg=(2.0, 12.0)), 2.0, 12.0),
    ],
)
def test_ticks_go_on_while_ecg_and_either_of_tool_and_probe_are_recorded(scenario, begin_s, end_s) -> None:
    t_s = tick_times(scenario)
    assert t_s[0] == begin_s
    assert t_s[-1] == pytest.approx(end_s, abs=0.0021)
    np.testing.assert_allclose(np.diff(t_s), 0.001, atol=1e-9)


@pytest.mark.parametrize(
    "scenario", [recorded(tool=(1000.0, 1020.0)), recorded(tool=(19.5, 40.0)), recorded(tool=(0.0, 0.9))]
)
def test_clocks_that_hardly_overlap_are_refused(scenario) -> None:
    with pytest.raises(NoOverlapError, match="share less than a second; they must be on one clock"):
        tick_times(scenario)


def test_what_was_never_tracked_is_refused_by_its_name() -> None:
    require_tracked_poses(recorded())
    with pytest.raises(InvalidInputError, match=r"^tool recording: none of the 50 poses"):
        require_tracked_poses(recorded(tool_tracked=False))
    with pytest.raises(InvalidInputError, match=r"^ultrasound recording: none of the 50 poses"):
        require_tracked_poses(recorded(probe_tracked=False))


def test_too_few_heart_beats_are_refused() -> None:
    require_heart_beats(range(20), recorded())
    with pytest.raises(InvalidInputError, match=r"2 R peaks in 20 s on lead\(s\) II"):
        require_heart_beats(range(2), recorded())
