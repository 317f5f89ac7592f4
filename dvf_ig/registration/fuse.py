"""Fusion of LC2's pose with that of the boundary, and the covariance of both together."""

from dataclasses import dataclass

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.boundary.fit import BoundaryFit, fit_boundary
from dvf_ig.registration.lc2.curvature import Curvature, curvature_about

from .data import RegistrationData, RegistrationOptions
from .pose_chart import PoseChart
from .refine import Refined


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """The pose fused from LC2 and the boundary, with its covariance.

    Attributes:
        pose: target_from_source.
        covariance: (6, 6) rad², mm²; NaN where the pose is no minimum.
        curvature: of LC2's cost about its own pose.
        boundary: fit of the boundary from LC2's pose; None where the model's surface is not known or the
            slices show no boundary.
    """

    pose: Rigid
    covariance: FloatArray
    curvature: Curvature
    boundary: BoundaryFit | None


def fuse(data: RegistrationData, refined: Refined, options: RegistrationOptions) -> Fused:
    """Go a share of the way from LC2's pose to that of the boundary."""
    chart = PoseChart(refined.best.pose, data.center_mm)
    curvature = curvature_about(refined.inside, chart)
    covariance = curvature.covariance(refined.inside.information, data.prior)
    if data.visible_boundary is None:
        return Fused(refined.best.pose, covariance, curvature, None)
    boundary = fit_boundary(data.visible_boundary, refined.best.pose, data.center_mm)
    share = options.boundary_share
    pose = chart.pose(share * chart.coordinates(boundary.pose))
    # as good as both together would be if they erred alike
    covariance = (1.0 - share) * covariance + share * boundary.covariance
    return Fused(pose, covariance, curvature, boundary)
