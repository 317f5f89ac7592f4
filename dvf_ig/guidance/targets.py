"""Guidance to a line or a path: Gaussian laws (eqs 7–9) of the distance to a polyline that may beat."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from dvf_ig.core import (
    CycleTiming,
    DvfModel,
    FloatArray,
    IntArray,
    InvalidInputError,
    Rigid,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.core.arrays import frozen_floats
from dvf_ig.core.space.frames import check_frame
from dvf_ig.kernels.fixture_field import WITHOUT_RATE
from dvf_ig.kernels.laws import GAUSSIAN, direction_certainty, signed_potential
from dvf_ig.kernels.path import CORNER_MM

from .device import COMMON_DEVICE, DeviceLimits
from .evaluator import ForceSamples, checked_query
from .laws import Gaussian, Law
from .places import Status

FOLLOWED = 4
FARTHEST_MM = 5.0
"""Vertices that a point of a beating path follows, and its largest distance from the nearest of them."""


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

    @classmethod
    def beating(cls, model: DvfModel, points_mm: Any) -> "PathTarget":
        """A path (k, 3), drawn at the model's end-diastole, that moves with the model's surface.

        Each point moves as the FOLLOWED nearest vertices do, weighted by 1/distance.

        Raises:
            InvalidInputError: surfaces whose vertices do not correspond from phase to phase, or a point too
                far from the surface to move with it.
        """
        drawn = frozen_floats(points_mm, "path", (None, 3))
        if model.still:
            return cls.static(model.frame, drawn)
        first = model.reference[model.ed_phase]
        if not all(np.array_equal(mesh.triangles, first.triangles) for mesh in model.reference):
            raise InvalidInputError(
                f"a path cannot beat with {model.surface_name}, whose phases have different triangles: no "
                "point of it is known through the cycle; build the model from surfaces or from an image with "
                "motion (model build --surfaces, or --image with --labels or --seeds)"
            )
        followed = range(1, min(FOLLOWED, len(first.vertices_mm)) + 1)
        away_mm, nearest = (np.asarray(one) for one in cKDTree(first.vertices_mm).query(drawn, followed))
        farthest = int(away_mm[:, 0].argmax())
        if away_mm[farthest, 0] > FARTHEST_MM:
            raise InvalidInputError(
                f"point {farthest} of a path is {away_mm[farthest, 0]:.1f} mm from {model.surface_name} at "
                f"end-diastole, at most {FARTHEST_MM:g} mm is allowed of a path that beats with it; draw "
                "it on the surface that `model export` writes"
            )
        weight = 1.0 / np.maximum(away_mm, 1e-6)
        weight /= weight.sum(axis=1, keepdims=True)
        moved = [mesh.vertices_mm[nearest] - first.vertices_mm[nearest] for mesh in model.reference]
        points = [drawn + np.einsum("kn,kni->ki", weight, shift) for shift in moved]
        return cls(model.frame, np.stack(points), model.timing)

    def at(self, model_phase: float) -> FloatArray:
        """(k, 3) points at a phase, linear between its neighbours."""
        if self.timing is None:
            return np.asarray(self.points_mm[0])
        first, second, alpha = self.timing.bracket(model_phase)
        return np.asarray((1.0 - alpha) * self.points_mm[first] + alpha * self.points_mm[second])

    def distance(self, xyz_mm: FloatArray, model_phase: float) -> tuple[float, FloatArray]:
        """Distance (mm) of a point (3,) to the path, and the direction (3,) away from it.

        The direction is the mean over segments of the unit vector from each one's nearest point, weighted by
        max(0, 1 − (dᵢ − d)/CORNER_MM)². Its length is 1 beside a straight part, and falls where parts of the
        path lie on opposite sides, as a gradient of distance does across a medial axis. 0 on the path itself.
        """
        nearest, unit, weight, _ = self._segments(xyz_mm, model_phase)
        return nearest, np.asarray(weight @ unit)

    def rate(self, xyz_mm: FloatArray, model_phase: float) -> float:
        """∂d/∂φ in mm a cycle at a fixed point (3,); the nearest point keeps its share of its segment."""
        if self.timing is None:
            return 0.0
        _, unit, weight, share = self._segments(xyz_mm, model_phase)
        first, second, _ = self.timing.bracket(model_phase)
        width = (self.timing.fractions[second] - self.timing.fractions[first]) % 1.0
        moved = (self.points_mm[second] - self.points_mm[first]) / width
        drift = moved[:-1] + share[:, None] * np.diff(moved, axis=0)
        return -float(weight @ np.einsum("ij,ij->i", unit, drift))

    def _segments(
        self, xyz_mm: FloatArray, model_phase: float
    ) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Distance; of the k − 1 segments direction away, weight, and where on it the nearest point is."""
        path = self.at(model_phase)
        start, along = path[:-1], np.diff(path, axis=0)
        share = np.einsum("ij,ij->i", xyz_mm - start, along) / np.einsum("ij,ij->i", along, along)
        share = np.clip(share, 0.0, 1.0)
        apart = xyz_mm - start - share[:, None] * along
        each = np.linalg.norm(apart, axis=1)
        nearest = float(each.min())
        weight = np.maximum(0.0, 1.0 - (each - nearest) / CORNER_MM) ** 2
        unit = apart / np.where(each > 0.0, each, 1.0)[:, None]
        return nearest, unit, weight / weight.sum(), share


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

    def __init__(self, target: PathTarget, law: Law, *, device: DeviceLimits = COMMON_DEVICE) -> None:
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

        Raises:
            InvalidInputError: shapes that do not fit.
        """
        frame = self.target.frame
        return self.force_through(Rigid.identity(frame, frame), xyz_mm, model_phase)

    def force_through(
        self, model_from_query: Rigid, xyz_mm: Any, model_phase: Any, status: IntArray | None = None
    ) -> ForceSamples:
        """Forces in another frame than the path's; arguments and errors as of `Evaluator.force_through`.

        Of a heart that has kept its shape: a servo's path also follows its change.

        A point or a phase that is not finite gets no force and status FAULT.
        """
        require_same_frame(model_from_query.target, self.target.frame, "path of a fixture")
        xyz, phase, codes = checked_query(xyz_mm, model_phase, status)
        matrix, out = model_from_query.matrix[:3], np.empty((len(xyz), WITHOUT_RATE))
        for i, (point, at, code) in enumerate(zip(xyz, phase.tolist(), codes.tolist(), strict=True)):
            codes[i] = self.tick(matrix, point, at, code, out[i])
        force, distance, away = out[:, :3].copy(), out[:, 3].copy(), out[:, 4:].copy()
        return ForceSamples(model_from_query.source, force, distance, away, codes)

    def tick(
        self,
        model_from_query: FloatArray,
        xyz_mm: FloatArray,
        model_phase: float,
        input_status: int,
        out: FloatArray,
    ) -> int:
        """Force at one point, as of `dvf_ig.kernels.dynamic.force_tick`; arguments are not checked.

        Args:
            model_from_query: (3, 4) rigid map of the query frame into the path's.
            xyz_mm: (3,) point in the query frame.
            model_phase: phase of the model's cycle.
            input_status: anything but OK is returned with zero force.
            out: (7,) or more: force in N, distance in mm, direction away from the path; the rest NaN.
        """
        out[:3], out[3:] = 0.0, math.nan
        if input_status != Status.OK:
            return input_status
        x, y, z = xyz_mm.tolist()
        point = [r[0] * x + r[1] * y + r[2] * z + r[3] for r in model_from_query.tolist()]
        if not math.isfinite(sum(point) + model_phase):
            return int(Status.FAULT)
        rotation = model_from_query[:, :3]
        distance_mm, away = self.target.distance(np.array(point), model_phase)
        norm = math.sqrt(away @ away)
        certainty = direction_certainty(norm)
        if certainty > 0.0:
            pull = signed_potential(GAUSSIAN, self.law.delta_mm, self.law.m, distance_mm)
            out[:3] = (-self.law.cap_n * pull * certainty / norm * away) @ rotation
        out[3] = distance_mm
        out[4:7] = away @ rotation
        return int(Status.OK)
