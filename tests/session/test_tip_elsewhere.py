"""A session whose ultrasound shows the tool: where its tip should be it guides, elsewhere it does not."""

from dataclasses import replace

import numpy as np
import pytest
from toy_session import (
    CENTER,
    GUIDED_S,
    HOME,
    LAG_S,
    Streams,
    frame_events,
    run,
    ticks,
    toy_setup,
    toy_streams,
)

from dvf_ig.core import FloatArray
from dvf_ig.guidance import Hazard
from dvf_ig.session import GuidanceState, Session, TrackedFrame
from dvf_ig.session.reasons import DoubtCause, Refusal

pytestmark = pytest.mark.usefixtures("known_ultrasound")

UNTIL_S = 40.0
MM_PER_PX, OFF_PX = 4.0, 1.8
PLACE_PX = np.array([11.5, 11.5])
"""Column and row of the tip in every image."""


def tip_mm(t_s: float) -> FloatArray:
    """As `tool_events` has it, frame "tracker"."""
    tip = CENTER + np.array([0.3 * np.sin(3.0 * t_s), 6.0, 0.3 * np.cos(2.0 * t_s)])
    return np.asarray(HOME.inverse().apply_array(tip[None])[0])


def beside_mm(t_s: float) -> float:
    """The probe is rocked through the tip, again and again."""
    return 9.0 * float(np.sin(1.1 * t_s))


def shown(frame: TrackedFrame, off_px: float) -> TrackedFrame:
    """The frame of a probe that holds the tip at one pixel; the tool is seen `off_px` from it."""
    pose = np.eye(4)
    pose[:3, 3] = tip_mm(frame.t_s) - np.array([*(MM_PER_PX * PLACE_PX), beside_mm(frame.t_s)])
    row, column = np.mgrid[:24, :24]
    away = (column - PLACE_PX[0] - off_px) ** 2 + (row - PLACE_PX[1]) ** 2
    near = np.exp(-0.5 * (beside_mm(frame.t_s + LAG_S) / 1.5) ** 2)
    assert frame.image is not None
    image = np.clip(0.5 * frame.image + 180.0 * near * np.exp(-0.5 * away), 0, 255).astype(np.uint8)
    image[0, :2] = frame.image[0, :2]
    return replace(frame, image=image, tracker_from_probe=pose)


def states(off_px: float) -> list[GuidanceState]:
    """Seen `off_px` from where the tip should be."""
    streams: Streams = toy_streams(UNTIL_S)
    streams.frames = [shown(frame, off_px) for frame in frame_events(UNTIL_S)]
    with Session(toy_setup()) as session:
        return run(session, streams.merged(), ticks(GUIDED_S, UNTIL_S))


def test_a_tool_in_its_place_changes_nothing() -> None:
    found = states(0.0)
    assert all(state.doubt is None and state.transform.pose is not None for state in found)
    seen = found[-1].tip_seen
    assert seen is not None
    assert not seen.elsewhere


def test_a_tool_that_is_seen_elsewhere_takes_the_pose_away() -> None:
    found = states(OFF_PX)
    assert found[0].transform.pose is not None
    last = found[-1]
    assert last.tip_seen is not None
    # the nearest place that is nearly as bright, of a spot on pixels of 4 mm
    assert last.tip_seen.off_mm == pytest.approx(OFF_PX * MM_PER_PX - 3.0, abs=1.2)
    assert last.doubt is not None
    assert last.doubt.cause is DoubtCause.TIP_ELSEWHERE
    assert last.supervised.hazards & Hazard.POSE_CONTRADICTED
    np.testing.assert_array_equal(last.force_n, 0.0)
    # and no registration brings one back
    assert last.registration is not None
    assert last.registration.refused is not None
    assert last.registration.refused.cause is Refusal.TIP_ELSEWHERE
