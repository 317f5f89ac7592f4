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

from .prior import deformation_factor

POSE, SHIFT = slice(0, 6), slice(3, 6)
"""Of the unknowns: the six coordinates of `PoseChart`, its translation. The boundary's offset follows."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BlockCosts:
    """−log likelihood of blocks of space, to second order about one pose.

    Attributes:
        places_mm: (n, 3) middles of the blocks, target frame.
        gradient: (n, 7); curvature: (n, 7, 7), none negative.
    """

    places_mm: FloatArray
    gradient: FloatArray
    curvature: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """Pose and change of shape that blocks agree on best.

    Attributes:
        step_mm: (6,) from the pose of the blocks, in the coordinates of `PoseChart`.
        covariance_mm2: (6, 6) of it, if costs and prior are what they say.
        pull: (n, 6, 7) change of the pose with the gradient of each block, negative.
    """

    step_mm: FloatArray
    covariance_mm2: FloatArray
    pull: FloatArray


def joint_fit(costs: BlockCosts, known: FloatArray, slope: FloatArray, center_mm: FloatArray) -> JointFit:
    """Fit pose, offset and change of shape.

    Args:
        known: (7, 7) curvature, and slope: (7,) gradient, of what else is known: the offset, landmarks.
        center_mm: (3,) of the heart.
    Raises:
        numpy.linalg.LinAlgError: blocks and knowledge leave the pose open.
    """
    factor = deformation_factor(costs.places_mm, center_mm)
    shifts = costs.curvature[:, SHIFT]
    mixed = np.einsum("bdk,bde->ke", factor, shifts, optimize=True)
    own = np.einsum("bdk,bdl->kl", factor, shifts[:, :, SHIFT] @ factor, optimize=True)
    rigid = costs.curvature.sum(axis=0) + known
    whole = np.block([[rigid, mixed.T], [mixed, own + np.eye(len(own))]])
    inverse = np.linalg.inv(whole)[POSE]
    pull = np.repeat(inverse[None, :, :UNKNOWNS], len(factor), axis=0)
    pull[:, :, SHIFT] += np.einsum("pk,bdk->bpd", inverse[:, UNKNOWNS:], factor, optimize=True)
    step = -np.einsum("bpu,bu->p", pull, costs.gradient) - inverse[:, :UNKNOWNS] @ slope
    return JointFit(step, 0.5 * (inverse[:, POSE] + inverse[:, POSE].T), pull)


def none_negative(curvature: FloatArray) -> FloatArray:
    """(n, k, k) symmetric matrices without their negative parts."""
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.transpose(0, 2, 1)))
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1))
