"""The tool tip at any moment, predicted from the poses that the tracker had delivered by then."""

from collections import deque
from dataclasses import dataclass
from itertools import chain
from math import inf, isfinite, sqrt
from statistics import median
from typing import NamedTuple

import numpy as np

from dvf_ig.core import FloatArray, Points, read_only_arrays
from dvf_ig.core.space.rigid import RIGID_TOLERANCE, rigidity_defect
from dvf_ig.guidance import Hazard

from .clocks import StampOrder
from .events import ToolPose

MAX_AGE_S = 0.050
MAX_AGE_FRAMES = 2.5
"""A pose is too old at this many frames beyond its usual latency, and at MAX_AGE_S in any case: with the
latency counted in, a single lost frame of a tracker that is 5 ms late took the force away."""
VELOCITY_SPAN_S = 0.030
"""Velocity is the tip's displacement over about this long: three frames at 100 Hz."""
LATE_S = 0.015
LATE_POSES, JUDGED_POSES = 3, 5
"""The latency has jumped if LATE_POSES of the last JUDGED_POSES came LATE_S later than is usual."""
LATE_MM = 0.3
"""A jump of latency matters if the tip moves further than this in it: the prediction may err as much."""
FROZEN_POSES = 5
"""This many bit-identical poses in a row are one old pose, whatever their status."""
TO_AND_FRO_MM, TO_AND_FRO_S = 3.0, 0.030
"""A tip that goes this far, and as far back, within this time each has been two tips: it would be 20 g at
100 Hz. A tracker's noise at the end of a long tool stays below 2 mm."""
CONTRADICTED_STEPS, JUDGED_STEPS = 4, 10
"""Number of the last steps that lead back, from which on the poses contradict each other."""
RATE_POSES = 32
"""Poses over which the tracker's rate is the median."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ToolReading:
    """The tool at one moment.

    Attributes:
        hazard: why the tip is not known; NONE if it is.
        tip_tracker_mm: (3,) predicted tip; 0 unless known.
        velocity_mm_s: (3,) of the tip, by which it is predicted; 0 unless known.
        rotation: (3, 3) of tracker_from_tool, the newest; identity unless known.
        age_s: time since the newest pose that was tracked; infinite before the first.
    """

    hazard: Hazard
    tip_tracker_mm: FloatArray
    velocity_mm_s: FloatArray
    rotation: FloatArray
    age_s: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Tracked:
    """A pose that may be used."""

    t_s: float
    tip_mm: FloatArray
    rotation: FloatArray


class _Step(NamedTuple):
    """Displacement of the tip from one pose to the next, and whether it is large for its duration."""

    moved_mm: FloatArray
    large: bool

    @classmethod
    def of(cls, moved_mm: FloatArray, seconds: float) -> "_Step":
        return cls(moved_mm, seconds <= TO_AND_FRO_S and sqrt(moved_mm.dot(moved_mm)) > TO_AND_FRO_MM)


class ToolTracker:
    """Takes the tool's poses and predicts the tip by constant velocity (docs/theory/safety.md).

    A pose that is not OK, or not rigid, is left out: the tip is predicted from those before it until they are
    too old, and then the tool is lost. One that is not finite, or frozen, counts at once.

    Args:
        tip: tool tip, one point in frame "tool".
    """

    def __init__(self, tip: Points) -> None:
        self.order = StampOrder()
        self._tip_mm = tip.xyz_mm[0]
        self._waiting: deque[ToolPose] = deque()
        self._tracked: deque[_Tracked] = deque(maxlen=RATE_POSES)
        self._newest_s = -inf
        self._intervals_s: deque[float] = deque(maxlen=RATE_POSES - 1)
        self._newest = Hazard.TOOL_LOST
        """Hazard of the newest pose."""
        self._last_rows: list[list[float]] = []
        self._repeats = 0
        self._velocity = _ZERO
        self._frame_s = MAX_AGE_S
        self._usual_late_s = 0.0
        self._latencies: deque[float] = deque(maxlen=RATE_POSES)
        self._delayed = False
        self._step = _Step(_ZERO, large=False)
        self._back: deque[bool] = deque(maxlen=JUDGED_STEPS)
        """Whether each of the last steps of the tip led back."""
        self._contradicted = False

    def push(self, pose: ToolPose) -> bool:
        """Add one pose; False if it is not later than all before, and dropped."""
        accepted = self.order.accepts(pose.t_s)
        if accepted:
            self._waiting.append(pose)
        return accepted

    def at(self, now_s: float) -> ToolReading:
        """Return the tool as known at `now_s`, from the poses stamped until then; times in order."""
        self.order.advance(now_s)
        if self._waiting and self._waiting[0].t_s <= now_s:
            self._take_until(now_s)
        age_s = now_s - self._tracked[-1].t_s if self._tracked else inf
        hazard = self._hazard(now_s, age_s)
        if hazard:
            return ToolReading(hazard, _ZERO, _ZERO, _IDENTITY, age_s)
        newest = self._tracked[-1]
        tip_mm = newest.tip_mm + self._velocity * age_s
        tip_mm.setflags(write=False)
        return ToolReading(hazard, tip_mm, self._velocity, newest.rotation, age_s)

    def _hazard(self, now_s: float, age_s: float) -> Hazard:
        if self._newest_s == -inf:
            return Hazard.TOOL_LOST
        limit_s = min(MAX_AGE_S, MAX_AGE_FRAMES * self._frame_s + self._usual_late_s)
        if now_s - self._newest_s > limit_s:
            return Hazard.CLOCK_BACKWARDS if self.order.restarted else Hazard.STALE_TOOL
        if self._newest in (Hazard.NOT_FINITE, Hazard.TOOL_FROZEN):
            return self._newest
        if age_s > limit_s:
            return Hazard.TOOL_LOST
        if self._contradicted:
            return Hazard.TOOL_CONTRADICTED
        return Hazard.LATENCY_JUMP if self._delayed else Hazard.NONE

    def _take_until(self, now_s: float) -> None:
        while self._waiting and self._waiting[0].t_s <= now_s:
            self._latencies.append(now_s - self._waiting[0].t_s)
            self._take(self._waiting.popleft())
        self._delayed = self._come_late()

    def _come_late(self) -> bool:
        """Check whether poses come so late, against the usual, that the predicted tip may be far off."""
        if len(self._latencies) <= JUDGED_POSES:
            return False
        self._usual_late_s = usual_s = sorted(self._latencies)[len(self._latencies) // 2]
        recent = sorted(list(self._latencies)[-JUDGED_POSES:])
        excess_s = recent[-LATE_POSES] - usual_s
        return excess_s > LATE_S and sqrt(self._velocity.dot(self._velocity)) * excess_s > LATE_MM

    def _take(self, pose: ToolPose) -> None:
        if self._newest_s > -inf:
            self._intervals_s.append(pose.t_s - self._newest_s)
            self._frame_s = median(self._intervals_s)
        self._newest_s = pose.t_s
        matrix = pose.tracker_from_tool
        self._newest = self._hazard_of(matrix, pose.by_encoders)
        if matrix is None or self._newest:
            return
        rotation = matrix[:3, :3]
        tip_mm = rotation @ self._tip_mm + matrix[:3, 3]
        tip_mm.setflags(write=False)
        if self._tracked:
            last = self._tracked[-1]
            self._take_step(_Step.of(tip_mm - last.tip_mm, pose.t_s - last.t_s))
        self._tracked.append(_Tracked(pose.t_s, tip_mm, rotation))
        self._update_velocity()

    def _take_step(self, step: "_Step") -> None:
        """Note whether the tip's newest step, and the one before, were large and led there and back."""
        before, self._step = self._step, step
        large = before.large and step.large
        self._back.append(large and float(before.moved_mm @ step.moved_mm) < 0.0)
        self._contradicted = sum(self._back) >= CONTRADICTED_STEPS

    def _hazard_of(self, matrix: FloatArray | None, by_encoders: bool) -> Hazard:
        if matrix is None:
            return Hazard.TOOL_LOST
        rows: list[list[float]] = matrix.tolist()
        if not all(map(isfinite, chain.from_iterable(rows))):
            return Hazard.NOT_FINITE
        if rigidity_defect(matrix[:3, :3]) > RIGID_TOLERANCE:
            return Hazard.TOOL_LOST
        frozen = self._repeated(rows) and not by_encoders
        return Hazard.TOOL_FROZEN if frozen else Hazard.NONE

    def _repeated(self, rows: list[list[float]]) -> bool:
        """Check whether the pose has been the same, bit by bit, for FROZEN_POSES."""
        self._repeats = self._repeats + 1 if rows == self._last_rows else 1
        self._last_rows = rows
        return self._repeats >= FROZEN_POSES

    def _update_velocity(self) -> None:
        """Backward difference over VELOCITY_SPAN_S or up to twice that; zero if there is no such pose."""
        newest = self._tracked[-1]
        self._velocity = _ZERO
        for before in reversed(self._tracked):
            span_s = newest.t_s - before.t_s
            if span_s > 2 * VELOCITY_SPAN_S:
                return
            if span_s > max(VELOCITY_SPAN_S - 0.5 * self._frame_s, 0.0):
                self._velocity = (newest.tip_mm - before.tip_mm) / span_s
                self._velocity.setflags(write=False)
                return


_ZERO, _IDENTITY = np.zeros(3), np.eye(3)
_ZERO.setflags(write=False)
_IDENTITY.setflags(write=False)
