"""Second-order picture of the misfit about a pose, and where parts of the slices would rather have it.

The gradient of LC2 is exact (`similarity_step`), so differences of it give the curvature at a third of the
price of differences of the score. A part of the slices pulls by its gradient; divided by its share of the
curvature that is the step to its own optimum, with no search of its own.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.pose_chart import HEART_RADIUS_MM, PoseChart, distance_between

from .lc2 import Lc2
from .optimise import PosePrior

STEP_MM = 0.5


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Curvature:
    """Attributes:
    chart: of the pose.
    misfit: (s,) Σ w(1 − S) of each slice; gradient: (s, 6).
    hessian: (6, 6) of the whole misfit.
    """

    chart: PoseChart
    misfit: FloatArray
    gradient: FloatArray
    hessian: FloatArray

    @property
    def definite(self) -> bool:
        """Whether the pose is a minimum in every direction."""
        return bool(np.isfinite(self.hessian).all() and np.linalg.eigvalsh(self.hessian).min() > 0)

    def covariance(self, information: float, prior: PosePrior | None) -> FloatArray:
        """(6, 6) inverse curvature of −log posterior, rad² and mm²; NaN where that has no minimum.

        Args:
            information: number of observations in −n/2·log(1 − S).
            prior: what the pose was also held to.
        """
        total = information * self.hessian / (2.0 * max(float(self.misfit.sum()), 1e-12))
        if prior is not None:
            total = total + prior.normal_equations(self.chart.base, self.chart.center_mm)[0]
        if not np.isfinite(total).all() or np.linalg.eigvalsh(total).min() <= 0:
            return np.full((6, 6), np.nan)
        unit = np.diag([1 / HEART_RADIUS_MM] * 3 + [1.0] * 3)
        return np.asarray(unit @ np.linalg.inv(total) @ unit)

    def wish(self, part: BoolArray) -> Rigid:
        """The pose that a part of the slices (s,) would have, to first order."""
        share = float(self.misfit[part].sum() / self.misfit.sum())
        pull = self.gradient[part].sum(axis=0) - share * self.gradient.sum(axis=0)
        step = -np.linalg.solve(self.hessian, pull) / share
        return self.chart.pose(step.astype(np.float64))

    def disagreement_mm(self, part: BoolArray, other: BoolArray) -> float:
        """Mean distance over the heart between what two parts would have; inf where there is no minimum."""
        if not self.definite or not part.any() or not other.any():
            return float("inf")
        return distance_between(self.wish(part), self.wish(other), self.chart.center_mm)


def curvature_about(metric: Lc2, chart: PoseChart) -> Curvature:
    """Curvature of the misfit by central differences of its gradient."""
    here = metric.slopes(chart.base, chart.center_mm)
    hessian = np.empty((6, 6))
    for i, step in enumerate(STEP_MM * np.eye(6)):
        up, down = (metric.slopes(chart.pose(sign * step), chart.center_mm).gradient for sign in (1, -1))
        hessian[i] = (up - down).sum(axis=0) / (2.0 * STEP_MM)
    return Curvature(chart, here.misfit, here.gradient, 0.5 * (hessian + hessian.T))
