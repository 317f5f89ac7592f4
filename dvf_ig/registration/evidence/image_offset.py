"""How the image lies to its probe, by the views of the heart themselves, where a calibration may be wrong.

A wrong probe calibration moves every image by the same step in the probe's frame, and so by another step in
the tracker's for each position of the probe: no one pose of the heart undoes it. Pose ξ and step η are found
together, from the pose of a registration on, by the gradient of LC2 over each slice (`Lc2.cost_gradient`): a
step η about the image's middle m moves slice i as ξ = A_i η does. A Gaussian prior keeps to the calibration
what the views say nothing of. Touched landmarks do not move with the image: a pose that a wrong calibration
draws aside is away from them, which shows much smaller errors than the views alone do. A heart that has
changed its shape is another explanation of the same views: where the boundary shows one, the likelier counts.
"""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import minimize
from scipy.stats import f as f_distribution

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, Rigid, Warp, read_only_arrays
from dvf_ig.registration.lc2.lc2 import CostGradient, Lc2
from dvf_ig.registration.lc2.slices import SliceSet
from dvf_ig.registration.pose_chart import PoseChart
from dvf_ig.registration.shape.blocks import BlockedLc2
from dvf_ig.registration.start import LandmarkPrior

PRIOR_SIGMA_MM = 8.0
"""Standard deviation of each coordinate of the step: of a marker put on the probe again."""
SUSPICIOUS_LOG_RATIO = 8.4
"""Half the 99 % quantile of χ² of 6 degrees of freedom: a right calibration exceeds it once in a hundred
registrations. Those of ten threshold hearts reach 5.3, calibrations that are 6 mm and 4° off 6.2 to 18."""
CHANCE_LOG_RATIO = 5.3
"""Half the 90 % quantile: by this a calibration must explain the views better than a change of shape does. Of
threshold hearts 2104 to 2130 calibrations that are 6 mm and 4° off exceed a change by 6.1 or more, right ones
of hearts 5 mm different are at least 0.7 below it."""
STEPS = 30
"""Most steps of the search."""
BLOCK_MM = 20.0
"""Edge of the blocks of slices that a change of shape moves."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ProbePoses:
    """Poses of the probe at which the slices were seen.

    Attributes:
        rotations, translations_mm: (s, 3, 3), (s, 3) tracker_from_probe.
        probe_from_image: calibration that placed the slices, without its scale.
        middle_mm: (3,) middle of the image in the probe's frame.
    """

    rotations: FloatArray
    translations_mm: FloatArray
    probe_from_image: Rigid
    middle_mm: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ImageOffset:
    """The calibration at which the views fit the model best, and the pose there.

    Attributes:
        probe_from_image: calibration, without its scale.
        pose: target_from_source.
        moved_mm, turned_deg: by which the image's middle was moved, and the image turned.
        log_likelihood_ratio: of that calibration against the given one.
        landmarks: number of touched landmarks that count as well as the views.
        shape_log_ratio: of a change of the heart's shape that the boundary shows, against the given
            calibration and a rigid heart; None if it shows none.
    """

    probe_from_image: Rigid
    pose: Rigid
    moved_mm: float
    turned_deg: float
    log_likelihood_ratio: float
    landmarks: int = 0
    shape_log_ratio: float | None = None

    @property
    def limit(self) -> float:
        """The log-likelihood ratio above which the views contradict the calibration.

        Landmarks take their σ from their own 3n − 6 residuals: six parameters gain by chance 3·F(6, 3n − 6).
        """
        if self.shape_log_ratio is not None:
            return max(self.shape_log_ratio, 0.0) + CHANCE_LOG_RATIO
        if self.landmarks:
            return 3.0 * float(f_distribution.ppf(0.99, 6, 3 * self.landmarks - 6))
        return SUSPICIOUS_LOG_RATIO

    @property
    def suspicious(self) -> bool:
        """Whether the views contradict the calibration."""
        return self.log_likelihood_ratio > self.limit

    @property
    def sentence(self) -> str:
        """The sentence a user reads if it is suspicious."""
        what = "the views and the touched landmarks together fit" if self.landmarks else "the views fit"
        return (
            f"{what} the model much better with the image moved by {self.moved_mm:.1f} mm and turned "
            f"by {self.turned_deg:.1f}° on its probe: the calibration is of another day or probe, or the "
            "probe's marker has moved; calibrate the probe again"
        )


def fit_image_offset(
    probe: ProbePoses,
    metric: Lc2,
    pose: Rigid,
    center_mm: FloatArray,
    landmarks: LandmarkPrior | None = None,
) -> ImageOffset:
    """Find pose and calibration together.

    Patches keep their weights at the given calibration, so that the cost is smooth.

    Args:
        metric: LC2 of the slices; coarse ones do.
        pose: near the optimum, target_from_source.
        center_mm: (3,) about which poses turn, target frame.
        landmarks: touched on the patient, with a tool that has its own calibration.
    """
    poses, images = PoseChart(pose, center_mm), PoseChart(probe.probe_from_image, probe.middle_mm)

    def cost_at(step: FloatArray) -> tuple[float, FloatArray]:
        here = poses.pose(step[:6])
        each = metric.cost_gradient(here, center_mm, _placed(metric.slices, probe, images.pose(step[6:])))
        cost, gradient = _cost(each, metric.information, _motion(probe, here, center_mm), step[6:])
        if landmarks is not None:
            cost += landmarks.energy(here)
            gradient[:6] -= landmarks.normal_equations(here, center_mm)[1]
        return cost, gradient

    def cost_as_given(xi: FloatArray) -> tuple[float, FloatArray]:
        cost, gradient = cost_at(np.concatenate([xi, np.zeros(6)]))
        return cost, gradient[:6]

    search = partial(minimize, jac=True, method="BFGS", options={"maxiter": STEPS})
    solution = search(cost_at, np.zeros(12))
    if landmarks is None:
        as_given = cost_at(np.zeros(12))[0]
    else:
        as_given = float(search(cost_as_given, np.zeros(6)).fun)
    turn, shift = solution.x[6:9], solution.x[9:]
    return ImageOffset(
        probe_from_image=images.pose(solution.x[6:]),
        pose=poses.pose(solution.x[:6]),
        moved_mm=float(np.linalg.norm(shift)),
        turned_deg=float(np.degrees(np.linalg.norm(turn)) / HEART_RADIUS_MM),
        log_likelihood_ratio=as_given - float(solution.fun),
        landmarks=0 if landmarks is None else len(landmarks.target),
    )


def shape_log_ratio(metric: Lc2, rigid: Rigid, pose: Rigid, warp: Warp, center_mm: FloatArray) -> float:
    """Compute the log-likelihood ratio of a change of shape at one pose against a rigid heart at another.

    Each block of a slice is moved as its middle is.

    Args:
        rigid: target_from_source without a change of shape; pose: with it.
    """
    blocks = BlockedLc2(metric, block_mm=BLOCK_MM)
    middles = pose.apply_array((blocks.cell.astype(np.float64) + 0.5) * BLOCK_MM)
    changed = blocks.shifted(pose, -warp.at(middles)[0], center_mm)
    n = metric.information
    return _minus_log(metric.cost_gradient(rigid, center_mm), n) - _minus_log(changed, n)


def _minus_log(each: CostGradient, n: float) -> float:
    """−log likelihood of slices or their parts."""
    unexplained = float(each.cost.sum()) / max(float(each.weight.sum()), 1e-300)
    return 0.5 * n * math.log(max(unexplained, 1e-12))


def _cost(each: CostGradient, n: float, motion: FloatArray, step: FloatArray) -> tuple[float, FloatArray]:
    """−log posterior, and its gradient (12,) over pose and step.

    Args:
        n: number of independent observations.
        motion: (s, 6, 6) A of each slice; step: (6,) η from the given calibration.
    """
    total = float(each.cost.sum())
    share = 0.5 * n / max(total, 1e-12)
    cost = _minus_log(each, n) + 0.5 * float(step @ step) / PRIOR_SIGMA_MM**2
    along = share * np.einsum("si,sij->j", each.gradient, motion) + step / PRIOR_SIGMA_MM**2
    return cost, np.concatenate([share * each.gradient.sum(axis=0), along])


def _placed(slices: SliceSet, probe: ProbePoses, image: Rigid) -> FloatArray:
    """(s, 3, 3) `frame_from_pixel` of the slices where another calibration puts them."""
    step = image @ probe.probe_from_image.inverse()
    turned = np.swapaxes(probe.rotations, 1, 2)
    in_probe = turned @ slices.frame_from_pixel
    in_probe[:, :, 2] -= np.einsum("sij,sj->si", turned, probe.translations_mm)
    moved = step.rotation @ in_probe
    moved[:, :, 2] += step.translation_mm
    placed = probe.rotations @ moved
    placed[:, :, 2] += probe.translations_mm
    return placed


def _motion(probe: ProbePoses, pose: Rigid, center_mm: FloatArray) -> FloatArray:
    """(s, 6, 6) A: the ξ of each slice that a step η of the image on its probe is."""
    turn = pose.rotation @ probe.rotations
    middle = pose.apply_array(probe.rotations @ probe.middle_mm + probe.translations_mm) - center_mm
    out = np.zeros((len(turn), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = turn
    for k in range(3):
        out[:, 3:, k] = np.cross(middle, turn[:, :, k]) / HEART_RADIUS_MM
    return out
