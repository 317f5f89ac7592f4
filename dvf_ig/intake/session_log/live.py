"""Streams of a live session's log beyond a replay's: when each event came, each state, each answer.

    /exact/event    one row per event, before the event itself: its kind, its stamp, its arrival
    /exact/state    one row per state requested from the session, in order between the events
    /exact/work     one row per completed registration or beat evaluation: its number, and how often it had
                    been requested before

With these a replay pushes the same events and requests at the same moments, and so gives the same answers.
"""

import json
from collections.abc import Iterator
from enum import IntEnum
from typing import Literal

import numpy as np
from pydantic import Field

from dvf_ig.core.arrays import FloatArray
from dvf_ig.guidance import FixtureSet
from dvf_ig.intake.fixtures import FixturesConfig, RetimingName
from dvf_ig.io.ros import messages as ros
from dvf_ig.io.yaml_config import Section
from dvf_ig.session import EcgSamples, Event, Landmark, RespirationSample, ToolPose, TrackedFrame, Trigger
from dvf_ig.session.state import GuidanceState

from .document import (
    ECG,
    EXACT_FRAME,
    EXACT_TOOL,
    GUIDANCE,
    IMAGE,
    IMAGE_LABEL,
    POSE_LABEL,
    RESPIRATION,
    exact_pose,
    status_message,
)

LIVE = "live.json"
EVENT, STATE, WORK = "/exact/event", "/exact/state", "/exact/work"
LIVE_STREAMS = {EVENT: ros.ARRAY, STATE: ros.ARRAY, WORK: ros.ARRAY}
LOST = "lost"
"""Metadata key of a finished log: number of messages not written because the disk was too slow."""
STATE_COLUMNS = (
    "t_s",
    "phi",
    "sigma_phi",
    "rr_s",
    "phase_state",
    "model_phase",
    *(f"mr_from_tracker_{row}{column}" for row in range(3) for column in range(4)),
    "pose_age_s",
    "tre_bound_mm",
    *(f"tip_tracker_{axis}_mm" for axis in "xyz"),
    *(f"force_tracker_{axis}_n" for axis in "xyz"),
    *(f"wanted_tracker_{axis}_n" for axis in "xyz"),
    "distance_mm",
    "margin_mm",
    "breath_phase",
    "breath_mm",
    "breath_state",
    "status",
    "supervisor",
    "hazards",
    "lost",
)
"""Columns of a state; NaN if a value is not known. `lost` counts messages that were left out by then."""

Timed = tuple[float, str, str, ros.Message]
"""Time, topic, type and message."""


class EventKind(IntEnum):
    """First number of an event's row."""

    ECG = 0
    FRAME = 1
    TOOL = 2
    LANDMARK = 3
    REARM = 4
    DEVICE = 5
    """Pose of a tool that is a haptic device, by its encoders."""
    RESPIRATION = 6


class LiveDocument(Section):
    """The content of `live.json`: a session's setup except for its patient."""

    schema_: Literal["dvf_ig.live_log/1"] = Field(default="dvf_ig.live_log/1", alias="schema")
    fixtures: FixturesConfig
    retiming: RetimingName
    seed: int


def live_document(fixtures: FixtureSet, retiming: RetimingName, seed: int) -> bytes:
    """Encode a session's fixtures, retiming and seed as JSON.

    Raises:
        pydantic.ValidationError: a path that moves with no structure, which no configuration can state.
    """
    document = LiveDocument(fixtures=FixturesConfig.of(fixtures), retiming=retiming, seed=seed)
    return json.dumps(document.model_dump(mode="json", by_alias=True), indent=1).encode()


def event_messages(event: Event, arrived_s: float) -> Iterator[Timed]:
    """Yield an event's row, its data for a replay, and its ROS messages.

    Args:
        arrived_s: time of arrival; NaN for events that did not arrive from outside.
    """
    kind, t_s = _kind(event), event.start_s if isinstance(event, EcgSamples) else event.t_s
    yield t_s, EVENT, ros.ARRAY, ros.array(np.array([kind, t_s, arrived_s]), ("kind, t_s, arrived_s",))
    if isinstance(event, EcgSamples):
        yield t_s, ECG, ros.ARRAY, ros.array(event.samples, ("samples", "leads"))
    elif isinstance(event, TrackedFrame):
        row = np.append(_pose_row(t_s, event.tracker_from_probe), float(event.image is not None))
        yield t_s, EXACT_FRAME, ros.ARRAY, ros.array(row, (POSE_LABEL.format("probe") + IMAGE_LABEL,))
        if event.image is not None:
            yield t_s, IMAGE, ros.IMAGE, ros.image(t_s, "image", event.image)
        yield from _placed(t_s, "probe", event.tracker_from_probe)
    elif isinstance(event, RespirationSample):
        yield t_s, RESPIRATION, ros.ARRAY, ros.array(np.append(t_s, event.values), ("t_s, then values",))
    elif isinstance(event, ToolPose):
        row = _pose_row(t_s, event.tracker_from_tool)
        yield t_s, EXACT_TOOL, ros.ARRAY, ros.array(row, (POSE_LABEL.format("tool"),))
        yield from _placed(t_s, "tool", event.tracker_from_tool)


def _kind(event: Event) -> EventKind:
    if isinstance(event, ToolPose) and event.by_encoders:
        return EventKind.DEVICE
    for kind, types in (
        (EventKind.ECG, EcgSamples | Trigger),
        (EventKind.FRAME, TrackedFrame),
        (EventKind.TOOL, ToolPose),
        (EventKind.LANDMARK, Landmark),
        (EventKind.RESPIRATION, RespirationSample),
    ):
        if isinstance(event, types):
            return kind
    return EventKind.REARM


def _pose_row(t_s: float, matrix: FloatArray | None) -> FloatArray:
    pose = np.eye(4) if matrix is None else matrix
    return exact_pose(t_s, matrix is not None, pose[:3, :3], pose[:3, 3])


def _placed(t_s: float, what: str, matrix: FloatArray | None) -> Iterator[Timed]:
    """Yield the pose for ROS, if it can be expressed as a quaternion."""
    if matrix is not None and np.isfinite(matrix).all() and np.linalg.det(matrix[:3, :3]) > 0.5:
        yield t_s, "/tf", ros.TF, ros.transforms(t_s, [("tracker", what, matrix)])


def state_message(state: GuidanceState, lost: int) -> Timed:
    """Build the row of a state."""
    phase, pose = state.phase, np.full((3, 4), np.nan)
    if state.transform.pose is not None and state.now_s < state.transform.pose_until_s:
        pose = state.transform.pose.matrices(np.array([state.now_s]))[0]
    tip = np.full(3, np.nan) if state.tool.hazard else state.tool.tip_tracker_mm
    row = np.array(
        [
            *(state.now_s, phase.phi, phase.sigma_phi, phase.rr_s, phase.state, state.model_phase),
            *pose.ravel(),
            *(state.pose_age_s, state.pose_bound_mm),
            *tip,
            *state.force_n,
            *state.wanted_n,
            *(state.distance_mm, state.margin_mm[0]),
            *(state.breath.phase, state.breath.displacement_mm, state.breath.state),
            *state.tick.codes,
            lost,
        ],
        dtype=np.float64,
    )
    return state.now_s, STATE, ros.ARRAY, ros.array(row, (", ".join(STATE_COLUMNS),))


def work_message(t_s: float, number: int, refused: int) -> Timed:
    """Build the row of work `number`, completed after `refused` earlier requests."""
    row = np.array([number, refused], dtype=np.float64)
    return t_s, WORK, ros.ARRAY, ros.array(row, ("number of the work, how often it was requested before",))


def answer_messages(state: GuidanceState) -> Iterator[Timed]:
    """Messages as they were sent, for ROS tools."""
    now_s, phase, pose = state.now_s, state.phase, state.transform.pose
    yield now_s, "/tool/force", ros.WRENCH, ros.wrench(now_s, "tracker", state.force_n)
    numbers = np.array(
        [
            *(phase.phi, state.model_phase, phase.rr_s, state.distance_mm, state.pose_age_s),
            *(state.breath.phase, state.breath.displacement_mm, state.breath.state),
        ]
    )
    yield now_s, "/guidance", ros.ARRAY, ros.array(numbers, (", ".join(GUIDANCE),))
    if pose is not None and now_s < state.transform.pose_until_s:
        matrix = pose.matrices(np.array([now_s]))[0]
        yield now_s, "/tf", ros.TF, ros.transforms(now_s, [("mr", "tracker", matrix)])
        if not state.tool.hazard:
            tip = matrix[:, :3] @ state.tool.tip_tracker_mm + matrix[:, 3]
            yield now_s, "/tool/tip", ros.POSE, ros.pose(now_s, "mr", tip)
    yield now_s, "/diagnostics", ros.DIAGNOSTICS, status_message(now_s, *state.tick.codes)
