"""A wide Gaussian prior about one pose: what the images do not observe stays there."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid

from .pose_chart import PoseChart

PRIOR_SIGMA_MM = 6.0
"""Standard deviation per coordinate: bounds what a beat, or a part of the slices, cannot observe."""


@dataclass(frozen=True, slots=True, eq=False)
class GaussianPrior:
    """A pose with a standard deviation of PRIOR_SIGMA_MM in every coordinate, as a prior of `optimise`."""

    chart: PoseChart

    def energy(self, pose: Rigid) -> float:
        xi = self.chart.coordinates(pose)
        return float(0.5 * (xi @ xi) / PRIOR_SIGMA_MM**2)

    def normal_equations(self, pose: Rigid, center_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Small turns add: the Jacobian of ξ is taken as the identity, and the centre as the chart's."""
        return np.eye(6) / PRIOR_SIGMA_MM**2, -self.chart.coordinates(pose) / PRIOR_SIGMA_MM**2
