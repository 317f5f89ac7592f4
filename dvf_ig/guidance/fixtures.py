"""Virtual fixtures bound to a patient's model: one force of all of them at a point and a phase."""

from collections.abc import Callable
from typing import Any

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, IntArray, InvalidInputError, Rigid, require_same_frame
from dvf_ig.kernels.dynamic import force_tick
from dvf_ig.kernels.fixture_field import DEPTH, LAW, POSE, TIMES

from .device import DeviceLimits
from .evaluator import Evaluator, ForceSamples, checked_query
from .fixture import FORBIDDEN_SURFACE, FixtureOptions, FixtureSet
from .joint_force import check_joint_stiffness, composed_force
from .margins.margin import widened
from .status import Status
from .targets import PathFixture

FORCE = slice(0, 3)
DISTANCE = 3
GRADIENT = slice(4, 7)
RATE = 7
CONFLICT = 8
TICK_OUTPUT = 9
"""What stands where in the output of `Fixtures.tick`, and its length."""

Tick = Callable[[FloatArray, FloatArray, float, int, FloatArray], int]


class SurfaceTick:
    """One tick of a fixture on the model's surface through a pose that may be another at every tick.

    Owns the kernel's arguments: each thread needs its own.
    """

    __slots__ = ("_coefficients", "_law", "_packed", "_pose")

    def __init__(self, evaluator: Evaluator) -> None:
        frame, self._law = evaluator.model.frame, evaluator.law
        self._coefficients, self._packed = evaluator.kernel_arguments(Rigid.identity(frame, frame))
        self._pose = self._packed[POSE:TIMES].reshape(3, 4)

    def widen(self, margin_mm: float) -> None:
        """The law with this margin from now on (`dvf_ig.guidance.margins.widened`)."""
        parameters = widened(self._law, margin_mm).parameters
        self._packed[LAW + 1], self._packed[DEPTH] = parameters[1], parameters[4]

    def __call__(
        self,
        model_from_query: FloatArray,
        xyz_mm: FloatArray,
        model_phase: float,
        input_status: int,
        out: FloatArray,
    ) -> int:
        """As `Fixtures.tick`; fills the first 8 of `out`."""
        self._pose[...] = model_from_query
        return force_tick(self._coefficients, self._packed, xyz_mm, model_phase, input_status, out)


class Fixtures:
    """One or several fixtures, ready to evaluate their force together.

    A single fixture goes straight to its kernel; several are composed (`compose`: forbidden regions before
    guidance, one joint cap). Where any fixture has a status other than OK there is no force of any of them,
    and the first such status is that of all. Distance, gradient and rate are those of the primary fixture.

    At NO_PHASE only forbidden regions act, each at its worst phase (`dvf_ig.kernels.worst_phase`), and
    distance and gradient are those of the first of them.

    Args:
        model: this patient's model; every fixture on a surface is on its surface.
        options: the fixtures, their joint cap, and the device that renders them.
    Raises:
        InvalidInputError: laws beyond the device's limits, each alone or those on the surface together, or a
            path with an unfit law.
        FrameMismatchError: a path in another frame than the model.
    """

    def __init__(self, model: DvfModel, options: FixtureSet = FORBIDDEN_SURFACE) -> None:
        self.model = model
        self.options = options
        self.parts = tuple(_bound(model, one, options.device) for one in options.fixtures)
        check_joint_stiffness(options)
        self._ticks: tuple[Tick, ...] = tuple(
            SurfaceTick(part) if isinstance(part, Evaluator) else part.tick for part in self.parts
        )
        self._first = self._ticks[0]
        self._composed = options.composed
        self._parts_out = np.empty((len(self.parts), TICK_OUTPUT))
        self._first_wall = next((i for i, one in enumerate(options.fixtures) if one.forbidden), None)

    @property
    def walls(self) -> bool:
        """Whether a forbidden region is among them: then a force remains where the phase is not known."""
        return self._first_wall is not None

    def evaluate(
        self, model_from_query: Rigid, xyz_mm: Any, model_phase: Any, status: IntArray | None = None
    ) -> ForceSamples:
        """Forces at n points, in the query frame.

        Args:
            model_from_query: rigid map of the query frame into the model's.
            xyz_mm: (n, 3) points in the query frame.
            model_phase: (n,) phase of the model's cycle, taken modulo 1; or one number for all points.
            status: (n,) `Status` of the input; entries that are not OK get no force, but those of walls at
                NO_PHASE. None: all OK.
        Raises:
            FrameMismatchError: the model is in another frame than the map's target.
            InvalidInputError: shapes that do not fit.
        """
        if not self._composed:
            return self.parts[0].force_through(model_from_query, xyz_mm, model_phase, status)
        require_same_frame(model_from_query.target, self.model.frame, "registered model")
        xyz, phase, found = checked_query(xyz_mm, model_phase, status)
        matrix, out = model_from_query.matrix[:3], np.empty((len(xyz), TICK_OUTPUT))
        for i, (point, at, given) in enumerate(zip(xyz, phase.tolist(), found.tolist(), strict=True)):
            found[i] = self.tick(matrix, point, at, given, out[i])
        return ForceSamples(
            model_from_query.source,
            out[:, FORCE].copy(),
            out[:, DISTANCE].copy(),
            out[:, GRADIENT].copy(),
            found,
            out[:, RATE].copy(),
            conflict=out[:, CONFLICT] != 0.0,
        )

    def widen(self, margin_mm: FloatArray) -> None:
        """Margins (k,) of the fixtures in `tick` from now on; a path keeps its law.

        Raises:
            InvalidInputError: a margin that is negative or not finite.
        """
        for tick, margin in zip(self._ticks, margin_mm.tolist(), strict=True):
            if isinstance(tick, SurfaceTick):
                tick.widen(margin)

    def tick(
        self,
        model_from_query: FloatArray,
        xyz_mm: FloatArray,
        model_phase: float,
        input_status: int,
        out: FloatArray,
    ) -> int:
        """Force at one point, for a servo loop; the same bits as `evaluate`. Arguments are not checked.

        Uses buffers of its own: not for two threads at once.

        Args:
            model_from_query: (3, 4) rigid map of the query frame into the model's; may differ at every tick.
            xyz_mm: (3,) float64 point in the query frame, writable and contiguous (as kernels need it).
            model_phase: phase of the model's cycle.
            input_status: `Status` of all inputs together; anything but OK is returned, and gives no force
                unless it is NO_PHASE and there is a wall.
            out: (9,) force in N at FORCE, distance in mm at DISTANCE, its gradient at GRADIENT, its rate in
                mm a cycle at RATE (NaN of a path), and 1 at CONFLICT where fixtures oppose each other;
                vectors in the query frame.
        Returns:
            `Status` value; unless OK, or NO_PHASE with a wall, the force is zero and distance, gradient and
            rate are NaN.
        """
        if self._composed:
            return self._tick_of_all(model_from_query, xyz_mm, model_phase, input_status, out)
        found = self._first(model_from_query, xyz_mm, model_phase, input_status, out)
        out[CONFLICT] = 0.0
        return found

    def _tick_of_all(
        self,
        model_from_query: FloatArray,
        xyz_mm: FloatArray,
        model_phase: float,
        input_status: int,
        out: FloatArray,
    ) -> int:
        primary: int | None = 0
        if input_status == Status.NO_PHASE:
            primary = self._first_wall
        for tick, part in zip(self._ticks, self._parts_out, strict=True):
            found = tick(model_from_query, xyz_mm, model_phase, input_status, part)
            if primary is None or found not in (Status.OK, Status.NO_PHASE):
                out[...] = np.nan
                out[FORCE], out[CONFLICT] = 0.0, 0.0
                return found
        together = composed_force(self.options, self._parts_out[:, FORCE])
        out[...] = self._parts_out[primary]
        out[FORCE], out[CONFLICT] = together.force_n, together.conflict
        return found


def _bound(model: DvfModel, one: FixtureOptions, device: DeviceLimits) -> Evaluator | PathFixture:
    try:
        if one.path is None:
            return Evaluator(model, one.law, blend=one.blend, device=device)
        require_same_frame(model.frame, one.path.frame, "path of a fixture")
        return PathFixture(one.path, one.law, device=device)
    except InvalidInputError as exc:
        raise one.named(exc) from exc
