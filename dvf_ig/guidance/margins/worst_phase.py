"""Walls where the cardiac phase is not known: the worst phase of the model's cycle."""

from typing import Any

import numpy as np

from dvf_ig.core import IntArray, Rigid
from dvf_ig.guidance.evaluator import Evaluator, ForceSamples
from dvf_ig.guidance.laws import Confinement, Gaussian
from dvf_ig.guidance.status import Status


def worst_phase_forces(
    evaluator: Evaluator, model_from_query: Rigid, xyz_mm: Any, status: IntArray | None = None
) -> ForceSamples:
    """Forces of the model's phase in which a forbidden region reaches furthest past each point.

    That is max_i d_i outside of an organ and min_i d_i inside of a chamber. Guidance gets no force: it has
    no place to guide to. Forces step in direction where the worst phase changes; the slew limit bounds that.
    A distance is that of the chosen phase and its rate is zero, for the wall does not move.

    Args:
        evaluator, model_from_query, xyz_mm, status: as in `Evaluator.force_through`.
    Raises:
        FrameMismatchError, InvalidInputError: as there.
    """
    each = [
        evaluator.force_through(model_from_query, xyz_mm, phase, status)
        for phase in evaluator.model.timing.fractions.tolist()
    ]
    distance = np.array([one.distance_mm for one in each])
    sign = -1.0 if isinstance(evaluator.law, Confinement) else 1.0
    worst = np.argmax(np.where(np.isnan(distance), -np.inf, sign * distance), axis=0)
    chosen = np.arange(len(worst))
    found = np.array([one.status for one in each])
    usable = (found == int(Status.OK)).all(axis=0)
    unusable_status = np.max(np.where(found == int(Status.OK), -1, found), axis=0)
    force = np.array([one.force_n for one in each])[worst, chosen]
    gives_force = usable & (not isinstance(evaluator.law, Gaussian))
    gradient = np.array([one.gradient for one in each])[worst, chosen]
    return ForceSamples(
        model_from_query.source,
        np.where(gives_force[:, None], force, 0.0),
        np.where(usable, distance[worst, chosen], np.nan),
        np.where(usable[:, None], gradient, np.nan),
        np.where(usable, int(Status.OK), unusable_status),
        np.where(usable, 0.0, np.nan),
    )
