"""Covariance of a registered pose: what blocks leave open, how they scatter, and what no block can see.

    C = S + Σ ψψᵀ + C_placement + UNSEEN_MM² I

S is what pose and change of shape leave of each other (`shape.fit.joint_fit`). ψ are the influences of blocks
of space and of slices on that pose: whatever the noise within a block is like, the pose varies by

    Σ_cell ψψᵀ + Σ_slice ψψᵀ − Σ_(cell ∩ slice) ψψᵀ

for blocks of space share the difference of patient and pre-operative images, slices share the error of the
tracker (Cameron, Gelbach and Miller 2011: clusters two ways).

C_placement is what calibrations and clocks leave open. An error of the image calibration turns and shifts
every slice equally in its own axes, one of the clock (video latency, gating) compares every slice with a
wrong phase; no check inside the images sees either well. To first order the pose follows the slices' mean
displacement, and the slope of LC2's gradient over the phase.

The largest eigenvector of C, in mm at the heart's radius, is a small screw motion; its larger part, rotation
or translation, names the least-constrained direction and which view would constrain it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, IntArray, InvalidInputError, Rigid, read_only_arrays
from dvf_ig.registration.lc2.lc2 import CostGradient, Lc2
from dvf_ig.registration.lc2.slices import SliceSet
from dvf_ig.registration.pose_chart import covariance_to_mm
from dvf_ig.registration.shape.blocks import Influences, distinct_rows, none_negative
from dvf_ig.registration.shape.fit import JointFit

PHASE_STEP = 0.05
"""Step of the difference over the phase: as a rule one phase of the model."""
UNSEEN_MM = 0.22
"""Standard deviation per coordinate of what every block shares: the bias of LC2."""
AXES = ("left–right (L–R)", "anterior–posterior (A–P)", "superior–inferior (S–I)")
"""The axes of LPS."""
NEAR = 0.9
"""Cosine from which a direction is called after an axis."""


def sandwich(influence: FloatArray, cell: IntArray, number: IntArray) -> FloatArray:
    """(6, 6) two-way clustered covariance of Σ ψ.

    Args:
        influence: (b, 6) ψ of each block of each slice.
        cell: (b, 3) block of space; number: (b,) of the slice, −1 of what belongs to no slice.
    """
    both = np.column_stack([cell, number])
    total = _clustered(influence, cell) - _clustered(influence, both)
    total = total + _clustered(influence, number[:, None])
    return np.asarray(none_negative(total[None])[0])


def _clustered(influence: FloatArray, key: IntArray) -> FloatArray:
    """(6, 6) Σ over clusters of ψψᵀ, with the usual correction for few of them."""
    _, group = distinct_rows(key)
    count = int(group.max()) + 1
    sums = np.zeros((count, influence.shape[1]))
    np.add.at(sums, group, influence)
    return np.asarray(count / max(count - 1, 1) * sums.T @ sums)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PlacementUncertainty:
    """Uncertainty of calibrations and clocks.

    Attributes:
        image: (6, 6) rad², mm²: rotation about the image's lateral, axial and elevation axes, and position of
            its middle along them.
        event_s: standard deviation of the images' times against the heart's clock.
    """

    image: FloatArray
    event_s: float


USUAL_PLACEMENT = PlacementUncertainty(np.diag([np.radians(0.5) ** 2] * 3 + [0.5**2] * 3), 0.015)
"""0.5 mm and 0.5° per axis, as published N-wire calibrations have (Lasso 2014; Chen 2009), and half a frame
at 30 Hz. A calibration's own interval is not used: it tells of noise, not of the phantom, of the speed of
sound or of a marker that was mounted again."""


def image_covariance_mm2(
    slices: SliceSet, weight: FloatArray, pose: Rigid, center_mm: FloatArray, placement: PlacementUncertainty
) -> FloatArray:
    """(6, 6) of the pose from the image calibration, in the coordinates of `PoseChart`.

    Args:
        weight: (s,) how much each slice counts.
    """
    rows, columns = slices.images.shape[1:]
    middle = slices.frame_from_pixel @ np.array([(columns - 1) / 2, (rows - 1) / 2, 1.0])
    axes = slices.frame_from_pixel[:, :, :2] / np.linalg.norm(
        slices.frame_from_pixel[:, :, :2], axis=1, keepdims=True
    )
    elevation = np.cross(axes[:, :, 0], axes[:, :, 1])
    turned = pose.rotation @ np.concatenate([axes, elevation[:, :, None]], axis=2)
    arm = center_mm - pose.apply_array(middle)
    share = weight / weight.sum()
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = HEART_RADIUS_MM * np.einsum("s,sij->ij", share, turned)
    jacobian[3:, :3] = np.einsum(
        "s,sij->ij", share, np.cross(turned, arm[:, :, None], axisa=1, axisb=1, axisc=1)
    )
    jacobian[3:, 3:] = np.einsum("s,sij->ij", share, turned)
    return np.asarray(jacobian @ placement.image @ jacobian.T)


def clock_covariance_mm2(
    slices: SliceSet,
    metric_of: Callable[[SliceSet], Lc2],
    pose: Rigid,
    center_mm: FloatArray,
    curvature: FloatArray,
    phase_sigma: float,
) -> FloatArray:
    """(6, 6) of the pose from a common error of the slices' phases, in the coordinates of `PoseChart`.

    Args:
        curvature: (6, 6) of −log posterior at the pose.
        phase_sigma: standard deviation of that error, in fractions of the cycle.
    """
    early, late = (
        _scaled(metric_of(replace(slices, model_phase=(slices.model_phase + shift) % 1.0)), pose, center_mm)
        for shift in (-PHASE_STEP, PHASE_STEP)
    )
    slope = np.linalg.solve(curvature, (late - early) / (2.0 * PHASE_STEP))
    return np.asarray(phase_sigma**2 * np.outer(slope, slope))


def _scaled(metric: Lc2, pose: Rigid, center_mm: FloatArray) -> FloatArray:
    """(6,) gradient of −log likelihood."""
    at_pose: CostGradient = metric.cost_gradient(pose, center_mm)
    total = max(float(at_pose.cost.sum()), 1e-12)
    return np.asarray(0.5 * metric.information / total * at_pose.gradient.sum(axis=0))


def covariance_mm2(fit: JointFit, influences: Influences) -> FloatArray:
    """(6, 6) without what the slices' placement adds, in the coordinates of `PoseChart`."""
    pulls = -np.einsum("gpu,gu->gp", fit.pull[influences.block], influences.gradient)
    scatter = sandwich(pulls, influences.block[:, None], influences.slice)
    return np.asarray(fit.covariance_mm2 + scatter + UNSEEN_MM**2 * np.eye(6))


def placement_covariance_mm2(
    slices: SliceSet,
    metric_of: Callable[[SliceSet], Lc2],
    pose: Rigid,
    center_mm: FloatArray,
    curvature: FloatArray,
    placement: PlacementUncertainty,
    rr_s: float | None,
) -> FloatArray:
    """(6, 6) that image calibration and clocks add.

    Args:
        rr_s: usual length of the beats; None for an organ that does not beat.
    """
    weight = slices.masks.sum(axis=(1, 2)).astype(np.float64)
    added = image_covariance_mm2(slices, weight, pose, center_mm, placement)
    if rr_s is None:
        return added
    phase_sigma = placement.event_s / rr_s
    return added + clock_covariance_mm2(slices, metric_of, pose, center_mm, curvature, phase_sigma)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LeastConstrained:
    """The least-constrained direction of a pose.

    Attributes:
        sigma_mm: standard deviation along it, at the heart's radius; inf where nothing constrains it.
        turning: whether it is mainly a rotation.
        axis: (3,) unit vector in the target frame (LPS): of the rotation, or of the translation.
        turn_share: share of the variance that is rotation.
    """

    sigma_mm: float
    turning: bool
    axis: FloatArray
    turn_share: float

    def sentence(self) -> str:
        """The direction in words, and which view would help."""
        if not np.isfinite(self.sigma_mm):
            return "the slices leave the pose open; sweep the probe over more of the heart, from other sides"
        x, y, z = self.axis
        k = int(np.abs(self.axis).argmax())
        name = f", {AXES[k]}" if abs(self.axis[k]) >= NEAR else ""
        along = f"({x:.1f}, {y:.1f}, {z:.1f}){name}"
        if self.turning:
            return (
                f"weakest: {self.sigma_mm:.1f} mm by turning about {along}; "
                "add views whose plane lies across that axis"
            )
        return f"weakest: {self.sigma_mm:.1f} mm along {along}; add views whose plane holds that direction"


def least_constrained_direction(covariance: FloatArray) -> LeastConstrained:
    """The direction of the largest variance, in mm at the heart's radius.

    Args:
        covariance: (6, 6) rad², mm²; rotation vector then translation, about the heart box's centre, axes
            LPS. Any value that is not finite says that the pose is not a minimum.
    Raises:
        InvalidInputError: another shape, or a negative variance.
    """
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.shape != (6, 6):
        raise InvalidInputError(f"a pose covariance has shape {matrix.shape}; needed (6, 6)")
    if not np.isfinite(matrix).all():
        return LeastConstrained(float("inf"), False, np.zeros(3), 0.0)
    values, vectors = np.linalg.eigh(covariance_to_mm(matrix))
    if values[0] < -1e-9 * max(values[-1], 1e-12):
        raise InvalidInputError(f"a pose covariance has a variance of {values[0]:.3g}; needed none below 0")
    worst = vectors[:, -1]
    turn_share = float(worst[:3] @ worst[:3])
    part = worst[:3] if turn_share > 0.5 else worst[3:]
    axis = part / np.linalg.norm(part)
    axis *= np.sign(axis[np.abs(axis).argmax()])
    return LeastConstrained(float(np.sqrt(values[-1])), turn_share > 0.5, axis, turn_share)
