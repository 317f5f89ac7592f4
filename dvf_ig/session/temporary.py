from dataclasses import dataclass

from dvf_ig.core import FloatArray, PhaseForecast, PoseMotion, RetimingCurve


@dataclass(frozen=True, slots=True, eq=False)
class PoseAndPhase:
    pose: PoseMotion | None
    phase: PhaseForecast
    retiming: RetimingCurve | None
    covariance_mm2: FloatArray | None
    pose_until_s: float
