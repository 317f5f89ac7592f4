"""Faults of what arrives: tool poses, ultrasound frames and packets of the ECG, and their stamps."""

from collections.abc import Callable
from dataclasses import replace
from itertools import cycle
from statistics import median

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.session import EcgSamples, Event, ToolPose, TrackedFrame
from dvf_ig.study.faults.streams import Arrivals

from .fault import ArrivalsChange, When


def missing(arrivals: Arrivals, when: When) -> Arrivals:
    """Nothing arrives."""
    inside = _inside(arrivals, when)
    return [*arrivals[: inside.start], *arrivals[inside.stop :]]


def not_tracked(arrivals: Arrivals, when: When) -> Arrivals:
    """The tracker does not report OK."""
    return _events_changed(arrivals, when, lambda event: _with_pose(event, None))


def without_image(arrivals: Arrivals, when: When) -> Arrivals:
    """Frames of an ultrasound machine that shows nothing."""

    def blank(event: Event) -> Event:
        return replace(event, image=None) if isinstance(event, TrackedFrame) else event

    return _events_changed(arrivals, when, blank)


def frozen(arrivals: Arrivals, when: When) -> Arrivals:
    """The last pose before is reported again and again, bit for bit, with status OK."""
    held = _pose_of(arrivals[_inside(arrivals, when).start - 1][1])
    return _events_changed(arrivals, when, lambda event: _with_pose(event, held))


def not_finite(arrivals: Arrivals, when: When) -> Arrivals:
    """One number of each pose is NaN."""

    def broken(event: Event) -> Event:
        pose = _pose_of(event)
        if pose is None:
            return event
        matrix = pose.copy()
        matrix[1, 3] = np.nan
        return _with_pose(event, matrix)

    return _events_changed(arrivals, when, broken)


def scaled(factor: float) -> ArrivalsChange:
    """Poses whose rotation is scaled along one axis."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        def stretched(event: Event) -> Event:
            pose = _pose_of(event)
            return event if pose is None else _with_pose(event, pose @ np.diag([factor, 1.0, 1.0, 1.0]))

        return _events_changed(arrivals, when, stretched)

    return change


def to_and_fro(by_mm: float) -> ArrivalsChange:
    """Every other pose is that of another tool, which another program sends."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        turns = cycle((True, False))

        def elsewhere(event: Event) -> Event:
            pose = _pose_of(event)
            if pose is None or not next(turns):
                return event
            matrix = pose.copy()
            matrix[0, 3] += by_mm
            return _with_pose(event, matrix)

        return _events_changed(arrivals, when, elsewhere)

    return change


def late(by_s: float) -> ArrivalsChange:
    """Everything arrives later; the link keeps the order."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        inside = _inside(arrivals, when)
        out, newest_s = [], -np.inf
        for k, (arrived_s, event) in enumerate(arrivals):
            newest_s = max(newest_s, arrived_s + (by_s if inside.start <= k < inside.stop else 0.0))
            out.append((newest_s, event))
        return out

    return change


def stamped_back(by_s: float) -> ArrivalsChange:
    """The source's clock goes back, and on its old way at the end."""
    return lambda arrivals, when: _events_changed(
        arrivals, when, lambda event: stamped(event, stamp_of(event) - by_s)
    )


def drifting(rate: float) -> ArrivalsChange:
    """The source's clock gains `rate` seconds a second, and keeps what it gained."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        out = []
        for arrived_s, event in arrivals:
            t_s = stamp_of(event)
            gained_s = rate * (min(max(t_s, when.begin_s), when.end_s) - when.begin_s)
            out.append((arrived_s, stamped(event, t_s + gained_s) if gained_s else event))
        return out

    return change


def repeated(share: float) -> ArrivalsChange:
    """So large a share of what arrives comes a second time."""

    def change(arrivals: Arrivals, when: When) -> Arrivals:
        inside, out, owed = _inside(arrivals, when), [], 0.0
        for k, arrival in enumerate(arrivals):
            out.append(arrival)
            if inside.start <= k < inside.stop:
                owed += share / (1.0 - share)
                while owed >= 1.0:
                    out.append(arrival)
                    owed -= 1.0
        return out

    return change


def stamp_of(event: Event) -> float:
    """When the source says it was."""
    return event.start_s if isinstance(event, EcgSamples) else event.t_s


def stamped(event: Event, t_s: float) -> Event:
    """The event with another stamp."""
    if isinstance(event, EcgSamples):
        return EcgSamples(t_s, event.samples)
    return replace(event, t_s=t_s)


def _inside(arrivals: Arrivals, when: When) -> slice:
    """As many events from the begin on as usually fall between begin and end."""
    stamps = [stamp_of(event) for _, event in arrivals]
    first = int(np.searchsorted(stamps, when.begin_s))
    usual_s = median(np.diff(stamps[:100]).tolist())
    return slice(first, min(len(stamps), first + max(1, round((when.end_s - when.begin_s) / usual_s))))


def _events_changed(arrivals: Arrivals, when: When, change: Callable[[Event], Event]) -> Arrivals:
    inside = _inside(arrivals, when)
    changed = [(arrived_s, change(event)) for arrived_s, event in arrivals[inside]]
    return [*arrivals[: inside.start], *changed, *arrivals[inside.stop :]]


def _pose_of(event: Event) -> FloatArray | None:
    if isinstance(event, ToolPose):
        return event.tracker_from_tool
    return event.tracker_from_probe if isinstance(event, TrackedFrame) else None


def _with_pose(event: Event, matrix: FloatArray | None) -> Event:
    if isinstance(event, ToolPose):
        return ToolPose(event.t_s, matrix)
    return replace(event, tracker_from_probe=matrix) if isinstance(event, TrackedFrame) else event
