"""The pose-and-phase transform: tool pose and time to the place and phase of the model, and forces back."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError, Rigid
from dvf_ig.core.arrays import check_shape
from dvf_ig.kernels.dynamic import force_tick

from .evaluator import Evaluator, ForceSamples
from .status import Status

DEVICE_FRAME = "device"
"""Frame of forces that were turned by `tracker_from_device`."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseAndPhase:
    """(p_tracker, φ) ↦ (p_mr, φ): a tracked tool in the model's frame, and its force in the tracker's.

    Attributes:
        mr_from_tracker: the registration.
    """

    mr_from_tracker: Rigid

    def evaluate(
        self,
        evaluator: Evaluator,
        tip_tracker_mm: Any,
        model_phase: Any,
        valid: BoolArray,
        tracker_from_device: FloatArray | None = None,
        *,
        refusal: IntArray | None = None,
    ) -> ForceSamples:
        """Forces at the tool tip; none where the state is not valid.

        Args:
            evaluator: fixture in the target frame of the registration.
            tip_tracker_mm: (n, 3) tool tip, tracker frame; any value where not valid.
            model_phase: (n,) phase of the model's cycle; any value where not valid.
            valid: (n,) True where tool pose, phase and registration may all be used.
            tracker_from_device: (3, 3) or (4, 4), or one per sample, (n, 3, 3) or (n, 4, 4): orientation of
                the frame "device" in which forces and gradients are wanted; None leaves them in the tracker
                frame. Only the rotation acts: a force is a free vector.
            refusal: (n,) `Status` to report where not valid; default NO_PHASE.
        Raises:
            FrameMismatchError: the model is in another frame than the registration's target.
            InvalidInputError: shapes that do not fit, or a refusal that is OK.
        """
        ok = np.asarray(valid, dtype=np.bool_)
        reason = np.full(len(ok), int(Status.NO_PHASE)) if refusal is None else np.asarray(refusal)
        check_shape(reason, "refusal", (len(ok),))
        if (reason[~ok] == Status.OK).any():
            raise InvalidInputError("a refusal is OK where the state is not valid; give the reason")
        status = np.where(ok, int(Status.OK), reason)
        if tracker_from_device is None:
            return evaluator.force_through(self.mr_from_tracker, tip_tracker_mm, model_phase, status)
        device_from_tracker = np.swapaxes(_rotations(tracker_from_device, len(ok)), 1, 2)
        broken = np.asarray(~np.isfinite(device_from_tracker).all(axis=(1, 2)))
        status = np.where(broken & ok, int(Status.FAULT), status)
        samples = evaluator.force_through(self.mr_from_tracker, tip_tracker_mm, model_phase, status)
        turn = np.where(broken[:, None, None], np.eye(3), device_from_tracker)
        return ForceSamples(
            DEVICE_FRAME,
            np.einsum("nij,nj->ni", turn, samples.force_n),
            samples.distance_mm,
            np.einsum("nij,nj->ni", turn, samples.gradient),
            samples.status,
            samples.rate_mm_per_cycle,
        )

    def bind(self, evaluator: Evaluator) -> "BoundTick":
        """The same map as one call per servo tick, without allocation.

        Raises:
            FrameMismatchError: the model is in another frame than the registration's target.
        """
        return BoundTick(evaluator, self.mr_from_tracker)


class BoundTick(partial[int]):
    """One tick of the servo loop: tip (tracker frame) and model phase in, force (tracker frame) out.

    `tick(tip_tracker_mm, model_phase, input_status, out)` returns the `Status` value and fills `out`:

    Args:
        tip_tracker_mm: (3,) tool tip, tracker frame.
        model_phase: phase of the model's cycle.
        input_status: `Status` of phase, pose and tool together; anything but OK gives zero force.
        out: (7,) force in N, distance in mm, gradient, vectors in the tracker frame; (8,) for ∂d/∂φ as
            well, in mm a cycle.

    Arguments are not checked: the call goes straight to the kernel, for use in a servo loop.
    `PoseAndPhase.evaluate` is the same with checks. `args` are the leading arguments of
    `dvf_ig.kernels.dynamic.force_tick`, for loops that run inside a kernel and never cross Python.
    """

    __slots__ = ()

    def __new__(cls, evaluator: Evaluator, mr_from_tracker: Rigid) -> "BoundTick":
        return super().__new__(cls, force_tick, *evaluator.kernel_arguments(mr_from_tracker))


def _rotations(tracker_from_device: FloatArray, n: int) -> FloatArray:
    """(n, 3, 3) rotations of rigid maps given in any of the accepted shapes."""
    given = np.asarray(tracker_from_device, dtype=np.float64)
    stack = given[None] if given.ndim == 2 else given
    if stack.ndim != 3 or stack.shape[1:] not in ((3, 3), (4, 4)) or len(stack) not in (1, n):
        raise InvalidInputError(
            f"tracker_from_device has shape {given.shape}; needed (3, 3) or (4, 4), or one for "
            f"each of {n} samples"
        )
    return np.broadcast_to(stack[:, :3, :3], (n, 3, 3))
