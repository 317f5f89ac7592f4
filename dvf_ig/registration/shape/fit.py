"""Fit the pose together with the heart's change of shape: generalised least squares over blocks of space.

Each block of some centimetres gives, to second order, the position of its own part of the heart: with x the
pose and m_b the change of shape there its −log likelihood is gᵀu + ½uᵀKu, u = x + (0, m_b, 0). Without m the
optimum bends the pose to whatever part of the heart is seen; with m of the prior's covariance blocks near to
one another count as what they are, one observation of the pose between them (Aitken 1935).

The change of shape is a Gaussian process a priori: smooth over LENGTH_MM, RMS_MM on average, of every
direction, and without a rigid part over the heart, since that is the pose. This last condition separates pose
and change of shape where ultrasound sees a part of the heart only (Rasmussen and Williams 2006, ch. 2;
processes conditioned on linear functionals).

The costs of blocks are far from quadratic: what a block says of its position from 2 mm away is off by a
third. So the fit is repeated, with gradients taken where the fit before has moved the blocks
(docs/decisions/0033-alternating-pose-and-shape.md).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpstrf

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, Rigid, read_only_arrays
from dvf_ig.kernels.boundary import UNKNOWNS
from dvf_ig.registration.pose_chart import PoseChart, rigid_motion

from .blocks import POSE, SHIFT, BlockCosts, BlockedMatch, Influences, about_no_shift

LENGTH_MM, RMS_MM = 45.0, 1.5
"""Tracked sweeps of tuning hearts 1001–1008, calm, 1.2 mm different over 30 mm: on average 1.68 mm off
without a change of shape; 1.41 with 30 mm and 2.5 mm; 1.40, 1.37 and 1.35 with 45 mm and 1.5, 2 and 2.5 mm.
Gated volumes of seeds 101–105, where all of the heart is seen: 0.81 without, 0.83 with 2.5 mm."""
NODES = 5
"""Along an edge of the cube over which the change of shape has no rigid part."""
LEAST_VARIANCE = 1e-3
"""Share of a coordinate's variance that may be left out."""
OWN_MM = 1.0
"""Standard deviation per axis of what a block is off by that its neighbours are not: its part in changes of
shape shorter than a block, and LC2's own error of place, 0.6 mm in the median. On tuning hearts 1009–1020
1.65 mm instead of 1.73 in poor images, 0.89 instead of 0.92 in calm ones; 0.5 mm does nearly as well."""
TURNS = 8
"""Most turns of solving for the pose and the change of shape."""
SETTLED_MM = 0.03
"""Steps of the pose shorter than this end the descent."""
OFFSET_SIGMA_MM = 1.0
"""Standard deviation of the boundary's uniform offset about that of its fit."""


def deformation_factor(places_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(n, 3, k) F: the change of shape at (n, 3) places is F z with z of independent standard normals.

    Args:
        center_mm: (3,) of the heart, a cube of twice HEART_RADIUS_MM about which has no rigid part.
    """
    edge = np.linspace(-HEART_RADIUS_MM, HEART_RADIUS_MM, NODES)
    nodes = center_mm + np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
    everywhere = np.concatenate([places_mm, nodes])
    of_each_axis = np.sqrt(RMS_MM**2 / 3.0) * _cholesky(_alike(everywhere, everywhere))
    of_places, of_nodes = np.split(of_each_axis, [len(places_mm)])
    fit = np.linalg.pinv(rigid_motion(nodes, center_mm).reshape(-1, 6)).reshape(6, -1, 3)
    rigid_part = np.tensordot(
        rigid_motion(places_mm, center_mm), np.tensordot(fit, of_nodes, axes=(1, 0)), axes=1
    )
    field = of_places[:, None, None, :] * np.eye(3)[None, :, :, None]
    return np.asarray((field - rigid_part).reshape(len(places_mm), 3, -1))


def _cholesky(covariance: FloatArray) -> FloatArray:
    """(n, k) L with L Lᵀ the covariance but for LEAST_VARIANCE: pivoted, stopped early (LAPACK dpstrf)."""
    lower, pivots, rank, _ = dpstrf(covariance, tol=LEAST_VARIANCE, lower=1)
    factor = np.empty((len(covariance), rank))
    factor[pivots - 1] = np.tril(lower)[:, :rank]
    return factor


def _alike(a_mm: FloatArray, b_mm: FloatArray) -> FloatArray:
    """(n, m) correlation between (n, 3) and (m, 3) places."""
    apart = ((a_mm[:, None] - b_mm[None]) ** 2).sum(axis=-1)
    return np.asarray(np.exp(-0.5 * apart / LENGTH_MM**2))


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
    right = np.eye(len(normal), 7)
    right[:, 6] = -np.concatenate([gradient.sum(axis=0) + slope, shape])
    solved = np.linalg.solve(normal, right)
    solution, of_pose = solved[:, 6], solved[:, POSE].T
    pull = np.repeat(of_pose[None, :, :UNKNOWNS], len(factor), axis=0)
    pull[:, :, SHIFT] += np.einsum("pk,bdk->bpd", of_pose[:, UNKNOWNS:], factor, optimize=True)
    return JointFit(
        step_mm=solution[POSE],
        offset_step_mm=float(solution[6]),
        shift_mm=np.einsum("bdk,k->bd", factor, solution[UNKNOWNS:], optimize=True),
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


KnownPose = Callable[[PoseChart], tuple[FloatArray, FloatArray]]
"""(6, 6) curvature and (6,) gradient at the pose of a chart of what else is known of it: landmarks."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PoseAndShape:
    """Where the descent ended, and its first turn, whose linear model holds at the pose it began at.

    Attributes:
        pose: target_from_source.
        first: fit of the first turn.
        influences: of the parts of the blocks on it.
    """

    pose: Rigid
    first: JointFit
    influences: Influences


def pose_and_shape(match: BlockedMatch, chart: PoseChart, known: KnownPose) -> PoseAndShape:
    """Fit pose, offset and change of shape from the pose of a chart.

    Raises:
        numpy.linalg.LinAlgError: blocks and knowledge leave the pose open.
    """
    pose, offset_mm, shift_mm = chart.base, 0.0, np.zeros((len(match), 3))
    # blocks move by far less than the length over which changes of shape are smooth
    factor = deformation_factor(match.places_mm(pose), chart.center_mm)
    turns: list[tuple[JointFit, Influences]] = []
    for _ in range(TURNS):
        here = PoseChart(pose, chart.center_mm)
        costs, influences = match.costs(pose, shift_mm, offset_mm)
        curvature, slope = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
        curvature[POSE, POSE], slope[POSE] = known(here)
        curvature[6, 6] = OFFSET_SIGMA_MM**-2
        slope[6] = offset_mm * OFFSET_SIGMA_MM**-2
        fit = joint_fit(about_no_shift(costs, shift_mm), factor, curvature, slope)
        turns.append((fit, influences))
        pose, shift_mm = here.pose(fit.step_mm), fit.shift_mm
        offset_mm += fit.offset_step_mm
        if np.linalg.norm(fit.step_mm) < SETTLED_MM:
            break
    return PoseAndShape(pose, *turns[0])
