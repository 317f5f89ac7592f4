"""Pose as a function of time: from one to the next at a bounded speed, constant before and after.

Between `start_s` and `end_s`, with w = (t − start_s)/(end_s − start_s) and c = `center_mm`, a point that the
first pose puts at p₀ is at

    p(t) = R(w θ)(p₀ − c) + c + w s,        dp/dt = (θ × (p − c − w s) + s)/(end_s − start_s)

so that the heart turns about its centre at a steady rate and its centre moves at a steady speed.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core.arrays import BoolArray, FloatArray, check_shape, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError

from .frames import require_same_frame
from .rigid import Rigid

HEART_RADIUS_MM = 40.0
"""Radius that converts rad to mm, so that rotation and translation steps move the heart equally."""


def mean_displacement_mm(first: Rigid, second: Rigid, center_mm: FloatArray) -> float:
    """Compute the mean distance in mm between two poses over six points at the heart's radius."""
    corners = np.vstack([np.eye(3), -np.eye(3)]) * HEART_RADIUS_MM + center_mm
    source = first.inverse().apply_array(corners)
    return float(np.linalg.norm(second.apply_array(source) - corners, axis=1).mean())


UPDATE_MM_PER_S = 10.0
"""Largest speed of the model by a new pose, mean over the heart (docs/theory/safety.md)."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PoseMotion:
    """Motion from one pose to another; made by `still` and `towards`.

    Attributes:
        start, end: target_from_source, before and after.
        start_s, end_s: times of the motion; both −inf for a constant pose.
        center_mm: (3,) about which it turns, target frame.
        turn_rad: (3,) rotation vector θ from start to end, target frame.
        shift_mm: (3,) s, displacement of the centre from start to end, target frame.
    """

    start: Rigid
    end: Rigid
    start_s: float
    end_s: float
    center_mm: FloatArray
    turn_rad: FloatArray
    shift_mm: FloatArray

    def __post_init__(self) -> None:
        require_same_frame(self.start.target, self.end.target, "target of a pose's motion")
        require_same_frame(self.start.source, self.end.source, "source of a pose's motion")
        if not self.start_s <= self.end_s:
            raise InvalidInputError(
                f"a pose moves from {self.start_s:g} s to {self.end_s:g} s; needed times in order"
            )
        for name in ("center_mm", "turn_rad", "shift_mm"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), name, (3,)))

    @classmethod
    def still(cls, pose: Rigid) -> "PoseMotion":
        """Build the motion of a constant pose."""
        return cls(pose, pose, -math.inf, -math.inf, np.zeros(3), np.zeros(3), np.zeros(3))

    @classmethod
    def towards(
        cls,
        now: Rigid,
        target: Rigid,
        start_s: float,
        center_mm: FloatArray,
        speed_mm_s: float = UPDATE_MM_PER_S,
    ) -> "PoseMotion":
        """Build the motion from the pose in use to another.

        Args:
            now, target: target_from_source, same frames.
            start_s: start of the motion.
            center_mm: (3,) centre of the heart, target frame.
            speed_mm_s: speed of the heart: mean displacement over its duration (`mean_displacement_mm`).
        Raises:
            FrameMismatchError: the poses map between other frames.
            InvalidInputError: a speed that is not positive.
        """
        if not speed_mm_s > 0:
            raise InvalidInputError(f"the speed of a pose is {speed_mm_s:g} mm/s; it must be positive")
        duration_s = mean_displacement_mm(now, target, center_mm) / speed_mm_s
        return cls.between(now, target, start_s, start_s + duration_s, center_mm)

    @classmethod
    def between(
        cls, start: Rigid, end: Rigid, start_s: float, end_s: float, center_mm: FloatArray
    ) -> "PoseMotion":
        """Build the motion from one pose to another in a given time, as that of breathing.

        Raises:
            FrameMismatchError: the poses map between other frames.
            InvalidInputError: times that are not in order.
        """
        step = end @ start.inverse()
        turn = Rotation.from_matrix(step.rotation).as_rotvec()
        return cls(start, end, start_s, end_s, center_mm, turn, step.apply_array(center_mm) - center_mm)

    def at(self, t_s: float) -> Rigid:
        """Compute the pose at one time; exactly `start` before the motion and `end` after it."""
        if t_s >= self.end_s:
            return self.end
        if t_s <= self.start_s:
            return self.start
        matrix = self.matrices(np.array([t_s]))[0]
        return Rigid(self.end.target, self.end.source, matrix[:, :3], matrix[:, 3])

    def matrices(self, t_s: FloatArray) -> FloatArray:
        """Compute the pose's (n, 3, 4) rotation and translation at (n,) times."""
        t = np.asarray(t_s, dtype=np.float64)
        check_shape(t, "times", (None,))
        first, last = self.start.matrix[:3], self.end.matrix[:3]
        out = np.where((t >= self.end_s)[:, None, None], last, first)
        moving = self._moving(t)
        if moving.any():
            weight = self._weight(t[moving])
            turn = Rotation.from_rotvec(weight[:, None] * self.turn_rad).as_matrix()
            first[:, 3] -= self.center_mm
            between = turn @ first
            between[:, :, 3] += self.center_mm + weight[:, None] * self.shift_mm
            out[moving] = between
        return out

    def velocity_mm_s(self, xyz_mm: FloatArray, t_s: FloatArray) -> FloatArray:
        """Compute (n, 3) dp/dt, target frame, of points fixed in the source frame and now at `xyz_mm`.

        Args:
            xyz_mm: (n, 3) positions of the points at these times, target frame.
            t_s: (n,).
        """
        xyz, t = np.asarray(xyz_mm, dtype=np.float64), np.asarray(t_s, dtype=np.float64)
        check_shape(t, "times", (None,))
        check_shape(xyz, "points", (len(t), 3))
        out = np.zeros(xyz.shape)
        moving = self._moving(t)
        if moving.any():
            arm = xyz[moving] - self.center_mm - self._weight(t[moving])[:, None] * self.shift_mm
            out[moving] = (np.cross(self.turn_rad, arm) + self.shift_mm) / (self.end_s - self.start_s)
        return out

    def _moving(self, t_s: FloatArray) -> BoolArray:
        return np.asarray((t_s >= self.start_s) & (t_s < self.end_s))

    def _weight(self, t_s: FloatArray) -> FloatArray:
        return np.asarray((t_s - self.start_s) / (self.end_s - self.start_s))
