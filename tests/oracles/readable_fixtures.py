"""Fixtures evaluated at one point in Python; tests hold `Fixtures.evaluate` to it, bit by bit."""

from collections.abc import Callable

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, Rigid
from dvf_ig.guidance import Evaluator, Fixtures, FixtureSet, Status
from dvf_ig.guidance.fixtures import FORBIDDEN_SURFACE, composed_force
from dvf_ig.kernels.dynamic import force_tick
from dvf_ig.kernels.fixture_field import POSE

FORCE = slice(0, 3)
DISTANCE = 3
GRADIENT = slice(4, 7)
RATE = 7
CONFLICT = 8
TICK_OUTPUT = 9
"""What stands where in the output of `TickedFixtures.tick`, and its length."""

Tick = Callable[[FloatArray, FloatArray, float, int, FloatArray], int]


class SurfaceTick:
    """One tick of a fixture on the model's surface through a pose that may be another at every tick.

    Owns the kernel's arguments: each thread needs its own.
    """

    __slots__ = ("_coefficients", "_packed", "_pose")

    def __init__(self, evaluator: Evaluator) -> None:
        frame = evaluator.model.frame
        self._coefficients, self._packed = evaluator.kernel_arguments(Rigid.identity(frame, frame))
        self._pose = self._packed[POSE : POSE + 12].reshape(3, 4)

    def __call__(
        self,
        model_from_query: FloatArray,
        xyz_mm: FloatArray,
        model_phase: float,
        input_status: int,
        out: FloatArray,
    ) -> int:
        """As `TickedFixtures.tick`; fills the first 8 of `out`."""
        self._pose[...] = model_from_query
        return force_tick(self._coefficients, self._packed, xyz_mm, model_phase, input_status, out)


class TickedFixtures(Fixtures):
    """`Fixtures`, one point at a time; arguments are not checked."""

    def __init__(self, model: DvfModel, options: FixtureSet = FORBIDDEN_SURFACE) -> None:
        super().__init__(model, options)
        self._ticks: tuple[Tick, ...] = tuple(
            SurfaceTick(part) if isinstance(part, Evaluator) else part.tick for part in self.parts
        )
        self._parts_out = np.empty((len(self.parts), TICK_OUTPUT))

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
        found = self._ticks[0](model_from_query, xyz_mm, model_phase, input_status, out)
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
            primary = next((i for i, one in enumerate(self.options.fixtures) if one.forbidden), None)
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
