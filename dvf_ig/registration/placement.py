"""How well the slices are placed in space and time, and what that leaves of the pose.

An error of the image calibration turns and shifts every slice alike in its own axes, one of the clock (video
latency, gating) compares every slice with a wrong phase; no check inside the images sees either well. To
first order the pose follows the slices' mean displacement, and the slope of LC2's gradient over the phase.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, Rigid, read_only_arrays

from .lc2.lc2 import CostGradient, Lc2
from .lc2.slices import SliceSet

PHASE_STEP = 0.05
"""Of the difference over the phase: as a rule one phase of the model."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PlacementUncertainty:
    """What calibrations and clocks leave open.

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
    found: CostGradient = metric.cost_gradient(pose, center_mm)
    total = max(float(found.cost.sum()), 1e-12)
    return np.asarray(0.5 * metric.information / total * found.gradient.sum(axis=0))
