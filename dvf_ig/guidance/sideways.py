"""Stiffness of a fixture's force across the normal: where a surface curves, and where its direction is lost.

Along the normal a law is as stiff as it is steep (`DeviceLimits.checked`). Across it the force turns: by F·κ
beside a surface of curvature κ, and at a medial axis by up to F(K·G + 7.5·H) (`continuity`), where the fade
of a lost direction is steep. Both depend on the organ, so they are looked for on the model itself: the
Jacobian of the force in the cells of the spline. Its part along the normal is the law's own slope and taken
off, where |∇d| is near 1; about a medial axis it is not.
"""

from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError

from .device import MM_PER_M, DeviceLimits
from .evaluator import Evaluator
from .places import Status

REACH_MM = 5.0
"""How far from the guarded surface a tool is expected, either way. Further inside a closed surface there is
always a medial axis, and the force about it turns as fast as it fades."""
PHASES = 4
"""So many phases of the cycle are looked at, evenly spread."""
R3 = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)
"""1/g, 1/g², 1/g³ with g⁴ = g + 1 (Roberts 2018)."""
STEP_MM = 0.1
"""Half the span of the differences."""
DISTANCE_SLOPE = 0.8
"""From this |∇d| on a field is a distance; below, normals of several sides are blended."""
ALLOWED_SHARE = 0.02
"""Share of the places within reach that may be stiffer than the device renders. None at all would refuse
every heart: rims and grooves of a few mm² turn the force at 500 to 2500 N/m. The passivity controller acts
there."""


@dataclass(frozen=True, slots=True)
class SidewaysStiffness:
    """The stiffest place found.

    Attributes:
        n_per_mm: largest singular value of the Jacobian, without the law's own slope along the normal.
        distance_mm: of that place to the organ's surface, positive inside.
        xyz_mm: the place, model frame.
        model_phase: its phase.
        share_beyond: share of the places looked at that are stiffer than the device renders.
    """

    n_per_mm: float
    distance_mm: float
    xyz_mm: tuple[float, float, float]
    model_phase: float
    share_beyond: float


def sideways_stiffness(evaluator: Evaluator, device: DeviceLimits) -> SidewaysStiffness | None:
    """In the cells of the spline's knots within reach of the guarded surface; None if there are none.

    Args:
        evaluator: the fixture.
        device: whose stiffness is compared with.
    """
    looked_at = beyond = 0
    samples = _places(evaluator)
    depth_mm = float(evaluator.law.parameters[4])
    worst: SidewaysStiffness | None = None
    for phase in np.arange(PHASES) / PHASES:
        samples_there = evaluator.force(samples, phase)
        near = (samples_there.status == Status.OK) & (
            np.abs(samples_there.distance_mm - depth_mm) <= REACH_MM
        )
        if not near.any():
            continue
        places = samples[near]
        jacobian = _jacobian(evaluator, places, float(phase))
        gradient = samples_there.gradient[near]
        normal = gradient / np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)[:, None]
        along = np.einsum("ni,nij,nj->n", normal, jacobian, normal)
        along = np.where(np.linalg.norm(gradient, axis=1) >= DISTANCE_SLOPE, along, 0.0)
        rest = jacobian - along[:, None, None] * normal[:, :, None] * normal[:, None, :]
        stiffness = np.linalg.norm(np.nan_to_num(rest), ord=2, axis=(1, 2))
        at = int(stiffness.argmax())
        looked_at += len(stiffness)
        beyond += int((stiffness > device.allowed_stiffness_n_per_mm).sum())
        if worst is None or stiffness[at] > worst.n_per_mm:
            x, y, z = places[at].tolist()
            distance = float(samples_there.distance_mm[near][at])
            worst = SidewaysStiffness(float(stiffness[at]), distance, (x, y, z), float(phase), 0.0)
    return None if worst is None else replace(worst, share_beyond=beyond / looked_at)


def check_sideways(evaluator: Evaluator, device: DeviceLimits) -> None:
    """Hold a fixture on this organ to the device's stiffness across the normal.

    Raises:
        InvalidInputError: within reach of the guarded surface too large a share is stiffer than the device
            renders.
    """
    worst = sideways_stiffness(evaluator, device)
    allowed = device.allowed_stiffness_n_per_mm
    if worst is None or worst.share_beyond <= ALLOWED_SHARE:
        return
    x, y, z = worst.xyz_mm
    raise InvalidInputError(
        "the fixture's force turns too fast for the device: beside its law's slope it is stiffer than "
        f"{allowed * MM_PER_M:.4g} N/m at {worst.share_beyond:.0%} of the places within {REACH_MM:g} mm of "
        f"the guarded surface, {worst.n_per_mm * MM_PER_M:.4g} N/m at ({x:.1f}, {y:.1f}, {z:.1f}) mm, "
        f"{worst.distance_mm:.2g} mm below the surface; the organ is thin or sharply curved there: lower the "
        "cap, or use a smoother surface"
    )


def _places(evaluator: Evaluator) -> FloatArray:
    """(n, 3) places, one in each knot's cell, by a sequence that spreads evenly over the cells (R₃)."""
    model = evaluator.model
    knot = float(model.knot_spacing_mm)
    axes = [
        low + knot * np.arange(1, round((high - low) / knot))
        for low, high in zip(model.origin_mm.tolist(), model.upper_mm.tolist(), strict=True)
    ]
    knots = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(knots + knot * (np.outer(np.arange(len(knots)), R3) % 1.0 - 0.5))


def _jacobian(evaluator: Evaluator, places: FloatArray, phase: float) -> FloatArray:
    """(n, 3, 3) ∂F/∂q by central differences, N/mm."""
    columns = []
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = STEP_MM
        ahead, behind = (evaluator.force(places + sign * step, phase).force_n for sign in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * STEP_MM))
    return np.stack(columns, axis=2)
