"""A recorded intervention as the events that a session is pushed, in order of time."""

from collections.abc import Iterator
from heapq import merge
from operator import itemgetter

import numpy as np

from dvf_ig.core import FloatArray, PoseStream, Scenario, TriggerTimes
from dvf_ig.session import EcgSamples, Event, Landmark, RespirationSample, ToolPose, TrackedFrame, Trigger

from .preconditions import tool_of

ECG_CHUNK = 50
"""ECG samples that are pushed at once; nothing depends on it."""

Timed = tuple[float, Event]
"""When an event is pushed, not after its first sample's stamp, and the event."""


def events_of(scenario: Scenario, *, ecg_chunk: int = ECG_CHUNK) -> Iterator[Timed]:
    """Everything that was recorded live, in order of time; nothing of the truth."""
    beats, tool = _beats(scenario, ecg_chunk), _tool(tool_of(scenario))
    streams = (_landmarks(scenario), beats, _breaths(scenario), _frames(scenario), tool)
    return merge(*streams, key=itemgetter(0))


def _beats(scenario: Scenario, chunk: int) -> Iterator[Timed]:
    ecg = scenario.ecg
    if isinstance(ecg, TriggerTimes):
        yield from ((t_s, Trigger(t_s)) for t_s in ecg.t_s.tolist())
        return
    for first in range(0, len(ecg), chunk):
        start_s = ecg.start_s + first / ecg.rate_hz
        yield start_s, EcgSamples(start_s, ecg.samples[first : first + chunk])


def _breaths(scenario: Scenario) -> Iterator[Timed]:
    recorded = scenario.respiration
    if recorded is None:
        return
    for t_s, values in zip(recorded.t_s.tolist(), recorded.values, strict=True):
        yield t_s, RespirationSample(t_s, values)


def _frames(scenario: Scenario) -> Iterator[Timed]:
    ultrasound = scenario.ultrasound
    poses = pose_matrices(ultrasound.stream("tracker", "probe"))
    for i, t_s in enumerate(ultrasound.t_s.tolist()):
        shown = ultrasound.images is not None and ultrasound.image_valid[i]
        image = ultrasound.images[i] if shown and ultrasound.images is not None else None
        yield t_s, TrackedFrame(t_s, image, poses[i])


def _tool(tool: PoseStream) -> Iterator[Timed]:
    for t_s, matrix in zip(tool.t_s.tolist(), pose_matrices(tool), strict=True):
        yield t_s, ToolPose(t_s, matrix)


def _landmarks(scenario: Scenario) -> Iterator[Timed]:
    """Landmarks were touched before the recording began."""
    mr, tracker = scenario.landmarks_mr, scenario.landmarks_tracker
    if mr is None or tracker is None:
        return
    names, marked, touched = mr.paired_with(tracker)
    begin_s = min(scenario.ecg.start_s, float(tool_of(scenario).t_s[0]), float(scenario.ultrasound.t_s[0]))
    for name, mr_mm, tracker_mm in zip(names, marked.xyz_mm, touched.xyz_mm, strict=True):
        yield begin_s, Landmark(begin_s, name, mr_mm, tracker_mm)


def pose_matrices(stream: PoseStream) -> list[FloatArray | None]:
    """(4, 4) each, read-only; None if the status was not OK."""
    matrices = np.tile(np.eye(4), (len(stream), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = stream.rotations, stream.translations_mm
    matrices.setflags(write=False)
    return [m if valid else None for m, valid in zip(matrices, stream.valid.tolist(), strict=True)]
