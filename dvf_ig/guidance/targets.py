"""Guidance to a line or a path: Gaussian laws (eqs 7–9) of the distance to a polyline that may beat."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core import CycleTiming, FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import check_shape, frozen_floats
from dvf_ig.core.frames import check_frame

from .blend import static_force
from .device import COMMON_DEVICE, DeviceLimits
from .evaluator import ForceSamples
from .laws import Gaussian
from .status import Status

CORNER_MM = 0.5
"""Parts of a path whose distances differ by less than about this have their directions blended."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PathTarget:
    """A polyline, static or moving with the heart; two points make a line.

    Attributes:
        frame: frame of the points, normally "mr".
        points_mm: (n, k, 3) k >= 2 points in each of n phases; point i is the same anatomical point in
            every phase.
        timing: of the n phases; None for n = 1, a static path.
    """

    frame: str
    points_mm: FloatArray
    timing: CycleTiming | None = None

    def __post_init__(self) -> None:
        check_frame(self.frame)
        points = frozen_floats(self.points_mm, "path", (None, None, 3))
        phases = 1 if self.timing is None else len(self.timing)
        if len(points) != phases or points.shape[1] < 2:
            raise InvalidInputError(
                f"a path has {points.shape[1]} points in {len(points)} phases; needed at least 2 points in "
                f"{phases} (one phase without timing)"
            )
        lengths = np.linalg.norm(np.diff(points, axis=1), axis=2)
        if not (lengths > 0.0).all():
            raise InvalidInputError("a path has two equal points in a row; remove one of them")
        object.__setattr__(self, "points_mm", points)

    @classmethod
    def static(cls, frame: str, points_mm: Any) -> "PathTarget":
        """A static path (k, 3)."""
        return cls(frame, np.array(points_mm, dtype=np.float64)[None])

    def at(self, model_phase: float) -> FloatArray:
        """(k, 3) points at a phase, linear between its neighbours."""
        if self.timing is None:
            return np.asarray(self.points_mm[0])
        first, second, alpha = self.timing.bracket(model_phase)
        return np.asarray((1.0 - alpha) * self.points_mm[first] + alpha * self.points_mm[second])

    def distance(self, xyz_mm: FloatArray, model_phase: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (n,) mm to the path and the direction (n, 3) away from it, each point at its own phase.

        The direction is the mean over segments of the unit vector from each one's nearest point, weighted by
        exp(−(dᵢ − d)/CORNER_MM). Its length is 1 beside a straight part, and falls where parts of the path
        lie on opposite sides, as a gradient of distance does across a medial axis. 0 on the path itself.
        """
        distance, away = np.empty(len(xyz_mm)), np.empty((len(xyz_mm), 3))
        for i, (point, phase) in enumerate(zip(xyz_mm, model_phase, strict=True)):
            distance[i], away[i] = _from_path(point, self.at(float(phase)))
        return distance, away


class PathFixture:
    """A path with a Gaussian law, ready to evaluate forces: the counterpart of `Evaluator` for surfaces.

    Args:
        target: the path.
        law: a Gaussian without depth; with m >= 1/2 it is within the device's stiffness sideways too, because
            F(d)/d nowhere exceeds the steepest slope.
        device: what the haptic device can render.
    Raises:
        InvalidInputError: another law, a depth, or a law beyond the device's limits.
    """

    def __init__(self, target: PathTarget, law: Gaussian, *, device: DeviceLimits = COMMON_DEVICE) -> None:
        if not isinstance(law, Gaussian):
            raise InvalidInputError(
                f"a path was given a {type(law).__name__} law; a distance without sign has no inside, use "
                "Gaussian"
            )
        if law.depth_mm != 0.0:
            raise InvalidInputError(
                f"a path was given a depth of {law.depth_mm:g} mm; it has no inside, use depth_mm = 0"
            )
        self.target = target
        self.law = device.checked(law)

    def force(self, xyz_mm: Any, model_phase: Any) -> ForceSamples:
        """Forces at (n, 3) points of the path's frame, at one model phase or (n,) of them.

        A point or a phase that is not finite gets no force and status FAULT.

        Raises:
            InvalidInputError: shapes that do not fit.
        """
        xyz = np.array(xyz_mm, dtype=np.float64)
        check_shape(xyz, "points", (None, 3))
        phase = np.array(model_phase, dtype=np.float64)
        if phase.ndim == 0:
            phase = np.full(len(xyz), phase)
        check_shape(phase, "model phase", (len(xyz),))
        good = np.isfinite(xyz).all(axis=1) & np.isfinite(phase)
        force, distance = np.zeros((len(xyz), 3)), np.full(len(xyz), np.nan)
        away = np.full((len(xyz), 3), np.nan)
        distance[good], away[good] = self.target.distance(xyz[good], phase[good])
        force[good] = static_force(self.law, distance[good], away[good])
        status = np.where(good, int(Status.OK), int(Status.FAULT)).astype(np.int64)
        return ForceSamples(self.target.frame, force, distance, away, status)


def _from_path(point: FloatArray, path: FloatArray) -> tuple[float, FloatArray]:
    """Distance and blended direction away from a polyline (k, 3)."""
    start, along = path[:-1], np.diff(path, axis=0)
    share = np.einsum("ij,ij->i", point - start, along) / np.einsum("ij,ij->i", along, along)
    apart = point - start - np.clip(share, 0.0, 1.0)[:, None] * along
    each = np.linalg.norm(apart, axis=1)
    nearest = float(each.min())
    weight = np.exp((nearest - each) / CORNER_MM)
    weight /= weight.sum()
    unit = apart / np.where(each > 0.0, each, 1.0)[:, None]
    return nearest, np.asarray(weight @ unit)
