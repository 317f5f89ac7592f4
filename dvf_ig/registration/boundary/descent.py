"""Robust Gauss–Newton descents from several starts, side by side; the scale is annealed from far to near."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import HEART_RADIUS_MM, BoolArray, FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.core.space.rigid import nearest_rotation
from dvf_ig.kernels.boundary import RIGHT, UNKNOWNS

from .options import BoundaryFitOptions
from .problem import BoundaryProblem, normal_matrices

NEAR_MM = 2.0
"""A point lies on the surface where it is so near to it."""
POINTS_PER_OBSERVATION = 30.0
"""Neighbouring points share their difference from the model: with this divisor the standard deviations match
the errors of fits on tuning seeds 101–103."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DescentEnds:
    """Where m descents ended; `poses` is (m, 3, 4), R and t: no value is made and checked at every step."""

    poses: FloatArray
    offsets_mm: FloatArray
    converged: BoolArray
    evaluations: IntArray


def descend(problem: BoundaryProblem, starts: Sequence[Rigid], opts: BoundaryFitOptions) -> DescentEnds:
    """Descents from all starts, side by side: a step of one costs less than the calls it takes."""
    problem.require_frames_of(starts[0])
    poses = np.stack([start.matrix[:3] for start in starts])
    offsets = np.full(len(starts), opts.expected_offset_mm)
    converged, used = np.zeros(len(starts), dtype=np.bool_), np.zeros(len(starts), dtype=np.int64)
    for level, sigma in enumerate(opts.sigmas_mm):
        last = level == len(opts.sigmas_mm) - 1
        size = UNKNOWNS if sigma <= opts.free_offset_mm else UNKNOWNS - 1
        tolerance_mm = opts.tolerance_mm * (1 if last else 10)
        going = np.arange(len(starts))
        for _ in range(opts.last_steps if last else opts.steps):
            sums = problem.sums(poses[going], offsets[going], sigma)
            steps = _steps(sums, offsets[going], size, opts)
            used[going] += 1
            poses[going] = _moved(poses[going], steps, problem.center_mm)
            offsets[going] += steps[:, 6]
            converged[going] = np.linalg.norm(steps, axis=1) < tolerance_mm
            going = going[~converged[going]]
            if len(going) == 0:
                break
    return DescentEnds(poses, offsets, converged, used)


def _moved(poses: FloatArray, xi_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(m, 3, 4) R and t after steps (m, >= 6) in the coordinates of `PoseChart`."""
    turns = Rotation.from_rotvec(xi_mm[:, :3] / HEART_RADIUS_MM).as_matrix()
    out = turns @ poses
    out[:, :, 3] += center_mm - turns @ center_mm + xi_mm[:, 3:6]
    return np.asarray(out)


def _steps(sums: FloatArray, offsets_mm: FloatArray, size: int, opts: BoundaryFitOptions) -> FloatArray:
    """(m, 7) Gauss–Newton steps of the first `size` unknowns, the others 0; none where nothing matches."""
    matrices = normal_matrices(sums)
    curvature, downhill = matrices[:, :size, :size].copy(), -sums[:, RIGHT : RIGHT + size]
    if size == UNKNOWNS:
        prior = POINTS_PER_OBSERVATION * (NEAR_MM / opts.offset_sigma_mm) ** 2
        curvature[:, 6, 6] += prior
        downhill[:, 6] -= prior * (offsets_mm - opts.expected_offset_mm)
    mean = np.trace(matrices[:, :6, :6], axis1=1, axis2=2) / 6
    steps, matched = np.zeros((len(sums), UNKNOWNS)), mean > 0
    damped = curvature[matched] + 1e-3 * mean[matched, None, None] * np.eye(size)
    steps[matched, :size] = np.linalg.solve(damped, downhill[matched, :, None])[:, :, 0]
    length = np.linalg.norm(steps[:, :6], axis=1, keepdims=True)
    return np.asarray(steps * np.minimum(1.0, opts.cap_mm / np.maximum(length, 1e-12)))


def pose_of(start: Rigid, pose: FloatArray) -> Rigid:
    """(3, 4) R and t as a rigid map between the frames of `start`."""
    return Rigid(start.target, start.source, nearest_rotation(pose[:, :3]), pose[:, 3])
