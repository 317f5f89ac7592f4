"""Walls without a known cardiac phase in readable form; `dvf_ig.kernels.worst_phase` says what they are."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import logsumexp

from dvf_ig.core import Rigid
from dvf_ig.guidance.blend import static_force
from dvf_ig.guidance.evaluator import Evaluator, ForceSamples
from dvf_ig.guidance.laws import Confinement, Gaussian
from dvf_ig.guidance.places import Status
from dvf_ig.kernels.worst_phase import SMOOTHING_MM


def worst_phase_forces(evaluator: Evaluator, model_from_query: Rigid, xyz_mm: Any) -> ForceSamples:
    """Forces of the smooth maximum of a wall's distance over the model's phases; guidance has none.

    Tests hold `Evaluator.force_through` at NO_PHASE to it.

    Args:
        evaluator, model_from_query, xyz_mm: as in `Evaluator.force_through`.
    Raises:
        FrameMismatchError, InvalidInputError: as there.
    """
    everywhere = Evaluator(replace(evaluator.model, seen=None), evaluator.law, blend=evaluator.blend)
    each = [
        everywhere.force_through(model_from_query, xyz_mm, phase)
        for phase in evaluator.model.timing.fractions.tolist()
    ]
    status, wall = each[0].status, not isinstance(evaluator.law, Gaussian)
    outward = -1.0 if isinstance(evaluator.law, Confinement) else 1.0
    reach = outward * np.array([one.distance_mm for one in each]) / SMOOTHING_MM
    total = logsumexp(reach, axis=0)
    share = np.exp(reach - total)
    gradient = np.einsum("in,inj->nj", share, np.array([one.gradient for one in each]))
    distance = outward * SMOOTHING_MM * total
    model = evaluator.model
    seen = np.ones(len(distance))
    if model.seen is not None:
        within = model_from_query.apply_array(np.asarray(xyz_mm))
        turned = [one.gradient @ model_from_query.rotation.T for one in each]
        phases = zip(each, turned, model.timing.fractions.tolist(), strict=True)
        shares = [model.seen.share(within, a.distance_mm, g, phase, model.timing) for a, g, phase in phases]
        seen = (share * np.array(shares)).sum(axis=0)
        status = np.where((status == int(Status.OK)) & (seen == 0.0) & wall, int(Status.UNSEEN), status)
    usable = (status == int(Status.OK)) & wall
    force = seen[:, None] * static_force(evaluator.law, distance, gradient)
    return ForceSamples(
        model_from_query.source,
        np.where(usable[:, None], force, 0.0),
        np.where(usable, distance, np.nan),
        np.where(usable[:, None], gradient, np.nan),
        np.where(status == int(Status.OK), int(Status.NO_PHASE), status),
        np.where(usable, 0.0, np.nan),
    )
