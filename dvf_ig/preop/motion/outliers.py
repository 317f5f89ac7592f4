"""Phases whose motion cannot be right, replaced by the motion of the phases around them.

A heart moves smoothly: the displacement of a phase lies near the mean of its neighbours'. If it does not, the
frame is corrupt, shifted or out of order, and the motion between its trusted neighbours is nearer to the
truth than the match. A phase that the motion makes no more similar to end-diastole is treated in the same
way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray

from .demons import DisplacementField
from .free_form import FreeForm

AnyDeformation = FreeForm | DisplacementField

LEAST_JUMP_MM, JUMP_RATIO = 1.2, 3.0
"""Largest accepted jump of a phase (RMS distance from its neighbours' mean over the voxels compared), in mm
and in medians over the cycle; a phase must exceed both to be rejected. Intact frames of ACDC jump by at most
0.93 mm (medians 0.25 to 0.5), one shifted by 14 mm by 11 to 13 mm, one swapped with one 7 frames later by 3.8
mm."""

FEWEST_PHASES = 10
"""Fewest phases for which jumps are judged: with fewer, the heart itself reverses within one phase."""

LEAST_GAIN = 0.02
"""Smallest share of the squared residual without motion that a motion has to remove."""


class Reason(Enum):
    """Reason for which the motion of a phase was replaced."""

    JUMP = "it jumps away from the phases around it: the frame is corrupt, shifted or out of order"
    NO_GAIN = "it makes the image no more similar to end-diastole than no motion does"


@dataclass(frozen=True, slots=True)
class ReplacedPhase:
    """Phase whose motion is interpolated between its trusted neighbours.

    Attributes:
        phase: index of the phase.
        reason: why its own motion was rejected.
        jump_mm: RMS distance of its own motion from its neighbours' mean if that was the reason, else 0.
    """

    phase: int
    reason: Reason
    jump_mm: float


def replace_outliers(
    deformations: Sequence[AnyDeformation], grey: AnyArray, mask: BoolArray, ed_phase: int
) -> tuple[tuple[AnyDeformation, ...], tuple[ReplacedPhase, ...]]:
    """Replace deformations that cannot be right by interpolation in time, and list the replaced phases.

    Args:
        deformations: one a phase, from end-diastole; the identity at `ed_phase`.
        grey: (n, nx, ny, nz) image on the grid of the deformations.
        mask: (nx, ny, nz) voxels that were compared.
    """
    repaired = list(deformations)
    rejected: dict[int, ReplacedPhase] = {}
    for phase in range(len(repaired)):
        if (
            phase != ed_phase
            and _share_left(repaired[phase], grey[ed_phase], grey[phase], mask) > 1 - LEAST_GAIN
        ):
            rejected[phase] = ReplacedPhase(phase, Reason.NO_GAIN, 0.0)
    _interpolate(repaired, rejected)
    moved = np.stack([d.on_voxels()[mask] for d in repaired])
    limit_mm = max(LEAST_JUMP_MM, JUMP_RATIO * float(np.median(_jumps_mm(moved))))
    while len(repaired) >= FEWEST_PHASES and len(rejected) < len(repaired) // 2:
        jumps_mm = _jumps_mm(moved)
        jumps_mm[[ed_phase, *rejected]] = 0.0
        worst = int(jumps_mm.argmax())
        if jumps_mm[worst] <= limit_mm:
            break
        rejected[worst] = ReplacedPhase(worst, Reason.JUMP, float(jumps_mm[worst]))
        _interpolate(repaired, rejected)
        for phase in rejected:
            moved[phase] = repaired[phase].on_voxels()[mask]
    return tuple(repaired), tuple(rejected[phase] for phase in sorted(rejected))


def _jumps_mm(moved_mm: FloatArray) -> FloatArray:
    """Compute (n,) RMS distances of each phase's displacement from its neighbours' mean, from (n, m, 3)."""
    middle = 0.5 * (np.roll(moved_mm, 1, axis=0) + np.roll(moved_mm, -1, axis=0))
    return np.asarray(np.sqrt(((moved_mm - middle) ** 2).sum(axis=-1).mean(axis=1)))


def _interpolate(repaired: list[AnyDeformation], rejected: dict[int, ReplacedPhase]) -> None:
    """Replace each rejected motion by one between the nearest trusted phases."""
    count = len(repaired)
    for phase in rejected:
        before = next(k for k in range(1, count + 1) if (phase - k) % count not in rejected)
        after = next(k for k in range(1, count + 1) if (phase + k) % count not in rejected)
        first, second = repaired[(phase - before) % count], repaired[(phase + after) % count]
        repaired[phase] = _between(first, second, before / (before + after))


def _between(first: AnyDeformation, second: AnyDeformation, weight: float) -> AnyDeformation:
    if isinstance(first, FreeForm) and isinstance(second, FreeForm):
        return FreeForm(first.lattice, (1.0 - weight) * first.coefficients + weight * second.coefficients)
    values = (1.0 - weight) * first.on_voxels() + weight * second.on_voxels()
    return DisplacementField(first.grid, values)


def _share_left(deformation: AnyDeformation, fixed: AnyArray, moving: AnyArray, mask: BoolArray) -> float:
    """Compute the share of the squared residual that the motion leaves; 0 if equal to end-diastole."""
    reference, values = fixed[mask].astype(np.float64), moving.astype(np.float64)
    at = np.indices(mask.shape) + np.moveaxis(deformation.on_voxels() / deformation.grid.spacing_mm, -1, 0)
    moved = ndimage.map_coordinates(values, at[:, mask], order=1, mode="nearest")
    left, before = (1.0 - _squared_correlation(reference, g) for g in (moved, values[mask]))
    return left / before if before > 0.0 else 0.0


def _squared_correlation(a: FloatArray, b: FloatArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float((a * a).sum() * (b * b).sum())
    return float((a * b).sum()) ** 2 / power if power > 0.0 else 0.0
