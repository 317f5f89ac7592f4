"""Margins of a session's fixtures: σ of the distance at the tip from all that the session knows.

What a session does not measure comes from constants: tip and tool as pivot calibrations and optical trackers
have them, the pose's ageing as in `pose_states`. The pose's covariance
holds probe calibration and lag as far as the registration states them (docs/theory/registration.md), so they
are not added again.
"""

from math import inf

import numpy as np

from dvf_ig.core import DvfModel, FloatArray
from dvf_ig.guidance import DeviceLimits, Evaluator, Fixtures, PoseAndPhase, Status
from dvf_ig.guidance.margins import DistanceSigma, distance_sigma, isotropic, next_margin_mm
from dvf_ig.guidance.servo import ServoTick
from dvf_ig.guidance.supervision.supervisor import SLEW_SPEED_M_S

from .pose_states import AGEING_MM_PER_S

TIP_SIGMA_MM = 0.3
"""Standard deviation of the calibrated tip, a coordinate. By judgement, on no heart."""
TOOL_SIGMA_MM = 0.25
"""Standard deviation of the tracked tool, a coordinate: accuracy that trackers state. By judgement."""
UPDATE_S = 1.0 / 30.0
"""Interval of updates of σ and of the margins: that of the inputs published to a servo."""
SERVO_PERIOD_S = 1e-3
"""A margin changes the force in one update by no more than the slew limit allows one tick of this length."""


def sigma_at(
    transform: PoseAndPhase,
    xyz_tracker_mm: FloatArray,
    t_s: float,
    gradient_model: FloatArray,
    rate_mm_per_cycle: FloatArray,
    pose_age_s: float,
    model: DvfModel,
) -> DistanceSigma:
    """Compute σ of the distance at n points.

    Args:
        transform: of the session at that time.
        xyz_tracker_mm: (n, 3) points, tracker frame; gradient_model: (n, 3) ∇d there, model frame.
        rate_mm_per_cycle: (n,) ∂d/∂φ; zero of a wall at its worst phase, whose phase adds no uncertainty.
        pose_age_s: since a beat confirmed the pose.
        model: of the heart; one from distant slices adds the uncertainty of its motion through them.
    """
    mapped = transform.at(xyz_tracker_mm, t_s)
    shape_mm2 = mapped.wall_variance_mm2[:, None, None] * np.eye(3)
    if model.seen is not None:
        shape_mm2 = shape_mm2 + model.seen.covariance_mm2(mapped.xyz_mm, mapped.model_phase, model.timing)
    nothing = isotropic(0.0)
    return distance_sigma(
        gradient_model,
        rate_mm_per_cycle,
        np.where(rate_mm_per_cycle == 0.0, 0.0, mapped.sigma_model_phase),
        registration_mm2=mapped.covariance_mm2,
        shape_mm2=shape_mm2,
        calibration_mm2=isotropic(TIP_SIGMA_MM),
        breathing_mm2=isotropic(AGEING_MM_PER_S * pose_age_s) if pose_age_s < inf else nothing * np.nan,
        tracking_mm2=isotropic(TOOL_SIGMA_MM),
    )


class MarginTracker:
    """Margins of the fixtures over time: targets by σ at the tip, reached within the slew rules.

    On the session's model alone, σ is that of the primary fixture; with further structures each fixture has
    its own, and the largest margin outside its structure's box.

    Args:
        fixtures: with the choice of a margin; a path keeps its law. Where no slice shows a surface, σ is not
            known.
        device: its stiffness gives the slew limit.
    """

    def __init__(self, fixtures: Fixtures, device: DeviceLimits) -> None:
        self._options, self._model, self._parts = fixtures.options.margin, fixtures.model, fixtures.parts
        self._laws = [None if one.path is not None else one.law for one in fixtures.options.fixtures]
        self._each = any(one.structure is not None for one in fixtures.options.fixtures)
        start = 0.0 if self._options.mode == "adaptive" else self._options.wanted_mm(np.nan)
        self.margin_mm = np.array([0.0 if law is None else start for law in self._laws])
        self.margin_mm.setflags(write=False)
        self._step_n = device.stiffness_n_per_m * SLEW_SPEED_M_S * SERVO_PERIOD_S
        self._updated_s = -inf
        self._target_mm = np.full(len(self._laws), start)

    def due(self, now_s: float) -> bool:
        """Whether an adaptive margin is to be updated."""
        return self._options.mode == "adaptive" and now_s >= self._updated_s + UPDATE_S

    def update(
        self,
        now_s: float,
        tick: ServoTick,
        transform: PoseAndPhase,
        tip_tracker_mm: FloatArray,
        pose_age_s: float,
    ) -> None:
        """Move towards the target by σ at the tip; without a force the last target stays.

        Args:
            tick: of the servo now; without a rate, as for a path, σ counts as unknown.
        """
        dt_s = min(now_s - self._updated_s, 2.0 * UPDATE_S)
        self._updated_s = now_s
        if tick.status in (Status.OK, Status.NO_PHASE) and transform.pose is not None:
            turn = transform.pose.at(now_s).rotation
            tip = tip_tracker_mm[None]

            def target_mm(model: DvfModel, distance_mm: float, slope: FloatArray, rate: float) -> float:
                rates = np.array([rate])
                sigma = sigma_at(transform, tip, now_s, slope[None], rates, pose_age_s, model)
                seen = _seen(model, transform, tip, now_s, distance_mm, slope)
                return self._options.wanted_mm(float(sigma.total_mm[0]) if seen else np.nan)

            if self._each:
                for i, part in enumerate(self._parts):
                    if isinstance(part, Evaluator):
                        at = transform.evaluate(part, tip, now_s)
                        distance_mm, rate = float(at.distance_mm[0]), float(at.rate_mm_per_cycle[0])
                        self._target_mm[i] = target_mm(part.model, distance_mm, turn @ at.gradient[0], rate)
            else:
                gradient, rate = turn @ tick.gradient, tick.rate_mm_per_cycle
                self._target_mm[:] = target_mm(self._model, tick.distance_mm, gradient, rate)
        margin_mm = np.array(
            [
                0.0 if law is None else next_margin_mm(now, target, dt_s, law, self._step_n)
                for now, target, law in zip(
                    self.margin_mm.tolist(), self._target_mm.tolist(), self._laws, strict=True
                )
            ]
        )
        margin_mm.setflags(write=False)
        self.margin_mm = margin_mm


def _seen(
    model: DvfModel,
    transform: PoseAndPhase,
    tip_mm: FloatArray,
    now_s: float,
    distance_mm: float,
    gradient: FloatArray,
) -> bool:
    """Whether slices show the surface nearest to the tip."""
    if model.seen is None:
        return True
    place, timing = transform.at(tip_mm, now_s), model.timing
    distance, phase = np.array([distance_mm]), float(place.model_phase[0])
    return bool(model.seen.share(place.xyz_mm, distance, gradient[None], phase, timing)[0] == 1.0)
