"""The pose together with the change of shape: generalised least squares over blocks of space.

Each block of some centimetres says, to second order, where its own part of the heart lies: with x the pose
and m_b the change of shape there its −log likelihood is gᵀu + ½uᵀKu, u = x + (0, m_b, 0). Without m the
optimum bends the pose to whatever part of the heart is seen; with m of the prior's covariance blocks near to
one another count as what they are, one observation of the pose between them (Aitken 1935).
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.kernels.boundary import UNKNOWNS

POSE, SHIFT = slice(0, 6), slice(3, 6)
"""Of the unknowns: the six coordinates of `PoseChart`, its translation. The boundary's offset follows."""
OWN_MM = 1.0
"""Standard deviation per axis of what a block is off by that its neighbours are not: its part in changes of
shape shorter than a block, and LC2's own error of place, 0.6 mm in the median. On tuning hearts 1009–1020
1.65 mm instead of 1.73 in poor images, 0.89 instead of 0.92 in calm ones; 0.5 mm does nearly as well."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BlockCosts:
    """−log likelihood of blocks of space, to second order about one pose.

    Attributes:
        gradient: (n, 7); curvature: (n, 7, 7), none negative.
    """

    gradient: FloatArray
    curvature: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """Pose and change of shape that blocks agree on best.

    Attributes:
        step_mm: (6,) from the pose of the blocks, in the coordinates of `PoseChart`.
        offset_step_mm: of the boundary's offset.
        shift_mm: (n, 3) smooth change of shape at the blocks, target frame.
        covariance_mm2: (6, 6) of the pose, if costs and prior are what they say.
        pull: (n, 6, 7) change of the pose with the gradient of each block, negative.
    """

    step_mm: FloatArray
    offset_step_mm: float
    shift_mm: FloatArray
    covariance_mm2: FloatArray
    pull: FloatArray


def joint_fit(costs: BlockCosts, factor: FloatArray, known: FloatArray, slope: FloatArray) -> JointFit:
    """Fit pose, offset and change of shape.

    Args:
        factor: (n, 3, k) of the change of shape at the blocks, see `deformation_factor`.
        known: (7, 7) curvature, and slope: (7,) gradient, of what else is known: the offset, landmarks.
    Raises:
        numpy.linalg.LinAlgError: blocks and knowledge leave the pose open.
    """
    kept = _kept_by_own_shift(costs.curvature)
    curvature = kept @ costs.curvature
    shifts = curvature[:, SHIFT]
    mixed = np.einsum("bdk,bde->ke", factor, shifts, optimize=True)
    own = np.einsum("bdk,bdl->kl", factor, shifts[:, :, SHIFT] @ factor, optimize=True)
    rigid = curvature.sum(axis=0) + known
    normal = np.block([[rigid, mixed.T], [mixed, own + np.eye(len(own))]])
    gradient = np.einsum("buv,bv->bu", kept, costs.gradient)
    shape = np.einsum("bdk,bd->k", factor, gradient[:, SHIFT], optimize=True)
    wanted = np.eye(len(normal), 7)
    wanted[:, 6] = -np.concatenate([gradient.sum(axis=0) + slope, shape])
    solved = np.linalg.solve(normal, wanted)
    found, of_pose = solved[:, 6], solved[:, POSE].T
    pull = np.repeat(of_pose[None, :, :UNKNOWNS], len(factor), axis=0)
    pull[:, :, SHIFT] += np.einsum("pk,bdk->bpd", of_pose[:, UNKNOWNS:], factor, optimize=True)
    return JointFit(
        step_mm=found[POSE],
        offset_step_mm=float(found[6]),
        shift_mm=np.einsum("bdk,k->bd", factor, found[UNKNOWNS:], optimize=True),
        covariance_mm2=0.5 * (of_pose[:, POSE] + of_pose[:, POSE].T),
        pull=pull @ kept,
    )


def _kept_by_own_shift(curvature: FloatArray) -> FloatArray:
    """(n, 7, 7) by which gradient and curvature are multiplied where each block also moves on its own.

    The block's own shift s ~ N(0, OWN_MM² I) is eliminated: min over s of g·u + ½(u + s)ᵀK(u + s) + ….
    """
    across = curvature[:, :, SHIFT]
    open_to_shift = np.linalg.inv(curvature[:, SHIFT, SHIFT] + np.eye(3) / OWN_MM**2)
    kept = np.repeat(np.eye(UNKNOWNS)[None], len(curvature), axis=0)
    kept[:, :, SHIFT] -= across @ open_to_shift
    return kept


def none_negative(curvature: FloatArray) -> FloatArray:
    """(n, k, k) symmetric matrices without their negative parts."""
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.transpose(0, 2, 1)))
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1))
