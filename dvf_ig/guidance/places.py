"""Where tracked points are in the model and in its cycle, and why a force was or was not produced there."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from dvf_ig.core import FloatArray, IntArray, read_only_arrays
from dvf_ig.kernels import status as code


class Status(IntEnum):
    """Anything but OK goes with zero force, except that walls of the worst phase remain at NO_PHASE."""

    OK = code.OK
    OUT_OF_VOLUME = code.OUT_OF_VOLUME
    """The tool is outside the box in which the model is defined: unprotected."""
    NO_PHASE = code.NO_PHASE
    """The cardiac phase is not valid: the phase clock is not locked. Guidance gives no force; forbidden
    regions are those of the worst phase (`dvf_ig.kernels.worst_phase`)."""
    NO_POSE = code.NO_POSE
    """The patient is not registered, or the registration must not be used."""
    STALE_TOOL = code.STALE_TOOL
    """The tool's pose is too old, or the tracker does not see it."""
    FAULT = code.FAULT
    """The input or the output was not finite."""
    UNSEEN = code.UNSEEN
    """No slice of the MR shows the nearest part of the surface: unprotected."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PlacesInModel:
    """Tracked points in the model's frame and cycle, at their times.

    What follows from the pose is NaN at NO_POSE, what follows from phase where phase may not be used, all of
    it at FAULT.

    Attributes:
        xyz_mm: (n, 3) model frame, through the warp of a heart that has changed its shape.
        velocity_mm_s: (n, 3) of the place by the motion of pose and warp, the tool held still; model frame.
        model_phase: (n,) in [0, 1).
        model_phase_rate_hz: (n,) cycles of the model a second.
        sigma_model_phase: (n,) one standard deviation.
        covariance_mm2: (n, 3, 3) of the place, by that of the pose, before the warp; NaN if that is unknown.
        wall_variance_mm2: (n,) of a wall there along its normal, by the change of shape.
        contraction: (n,) how many times as far as in the model the heart contracts (`Evaluator`).
        status: (n,) `Status`: OK, NO_POSE, NO_PHASE or FAULT.
    """

    xyz_mm: FloatArray
    velocity_mm_s: FloatArray
    model_phase: FloatArray
    model_phase_rate_hz: FloatArray
    sigma_model_phase: FloatArray
    covariance_mm2: FloatArray
    wall_variance_mm2: FloatArray
    contraction: FloatArray
    status: IntArray

    def __len__(self) -> int:
        return len(self.status)

    def distance_rate_mm_s(self, gradient: FloatArray, rate_mm_per_cycle: FloatArray) -> FloatArray:
        """(n,) ∂d/∂t where the tool is: ∇d·v + ∂d/∂φ dφ/dt, φ the model phase.

        Args:
            gradient: (n, 3) ∇d at the places, model frame.
            rate_mm_per_cycle: (n,) ∂d/∂φ.
        """
        by_pose = np.einsum("ni,ni->n", gradient, self.velocity_mm_s)
        return np.asarray(by_pose + rate_mm_per_cycle * self.model_phase_rate_hz)

    def distance_sigma_mm(self, gradient: FloatArray, rate_mm_per_cycle: FloatArray) -> FloatArray:
        """(n,) σ_d by pose and phase, taken as independent: σ_d² = ∇dᵀ C ∇d + (∂d/∂φ σ_φ)².

        Args:
            gradient, rate_mm_per_cycle: as in `distance_rate_mm_s`.
        """
        by_pose = np.einsum("ni,nij,nj->n", gradient, self.covariance_mm2, gradient)
        return np.asarray(
            np.sqrt(np.maximum(by_pose, 0.0) + (rate_mm_per_cycle * self.sigma_model_phase) ** 2)
        )
