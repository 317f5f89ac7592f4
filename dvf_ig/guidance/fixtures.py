"""Virtual fixtures bound to a patient's model: one force of all of them at a point and a phase."""

from typing import Any

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, IntArray, InvalidInputError, Rigid, require_same_frame

from .device import DeviceLimits
from .evaluator import Evaluator, ForceSamples
from .fixture import FORBIDDEN_SURFACE, FixtureOptions, FixtureSet
from .joint_force import check_joint_stiffness, composed_force
from .status import Status
from .targets import PathFixture


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
        self._composed = options.composed
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
        each = [part.force_through(model_from_query, xyz_mm, model_phase, status) for part in self.parts]
        codes, count = np.array([one.status for one in each]), len(each[0])
        refused = (codes != Status.OK) & (codes != Status.NO_PHASE)
        found = codes[np.argmax(refused, axis=0), np.arange(count)]
        given = ~refused.any(axis=0) & ((found == Status.OK) | self.walls)
        first = np.where(found == Status.NO_PHASE, self._first_wall or 0, 0)

        def primary(name: str) -> FloatArray:
            values = np.array([getattr(one, name) for one in each])[first, np.arange(count)]
            values[~given] = np.nan
            return values

        force, conflict = np.zeros((count, 3)), np.zeros(count, dtype=np.bool_)
        for i in np.flatnonzero(given).tolist():
            together = composed_force(self.options, np.array([one.force_n[i] for one in each]))
            force[i], conflict[i] = together.force_n, together.conflict
        return ForceSamples(
            model_from_query.source,
            force,
            primary("distance_mm"),
            primary("gradient"),
            found,
            primary("rate_mm_per_cycle"),
            conflict=conflict,
        )


def _bound(model: DvfModel, one: FixtureOptions, device: DeviceLimits) -> Evaluator | PathFixture:
    try:
        if one.path is None:
            return Evaluator(model, one.law, blend=one.blend, device=device)
        require_same_frame(model.frame, one.path.frame, "path of a fixture")
        return PathFixture(one.path, one.law, device=device)
    except InvalidInputError as exc:
        raise one.named(exc) from exc
