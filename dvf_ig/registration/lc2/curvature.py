"""Second-order expansion of LC2's cost about a pose.

The gradient of LC2 is exact (`kernels.lc2_step`), so differences of it give the curvature at a third of the
price of differences of the score.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.registration.pose_chart import PoseChart

from .lc2 import Lc2

STEP_MM = 0.5


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Curvature:
    """Cost of every slice to second order about a pose.

    Attributes:
        chart: of the pose.
        cost: (s,) Σ w(1 − S) of each slice; gradient: (s, 6).
        hessian: (6, 6) of the whole cost.
    """

    chart: PoseChart
    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray

    def scaled(self, information: float) -> FloatArray:
        """(6, 6) curvature of −log likelihood.

        Args:
            information: number of observations in −n/2·log(1 − S).
        """
        return np.asarray(information * self.hessian / (2.0 * max(float(self.cost.sum()), 1e-12)))


def curvature_about(metric: Lc2, chart: PoseChart) -> Curvature:
    """Curvature of the cost by central differences of its gradient."""
    here = metric.cost_gradient(chart.base, chart.center_mm)
    hessian = np.empty((6, 6))
    for i, step in enumerate(STEP_MM * np.eye(6)):
        up, down = (
            metric.cost_gradient(chart.pose(sign * step), chart.center_mm).gradient for sign in (1, -1)
        )
        hessian[i] = (up - down).sum(axis=0) / (2.0 * STEP_MM)
    return Curvature(chart, here.cost, here.gradient, 0.5 * (hessian + hessian.T))
