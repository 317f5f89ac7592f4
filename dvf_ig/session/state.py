"""What a session knows at one moment, and the force that follows from it."""

from dataclasses import dataclass
from math import nan

import numpy as np

from dvf_ig.core import FloatArray, PhaseReading, read_only_arrays
from dvf_ig.guidance import PoseAndPhase, RearmAnswer, Status, SupervisedForce, SupervisorState
from dvf_ig.registration import PoseEstimate, TipSighting

from .calibrations import CalibrationsInUse
from .refusal import Doubt
from .tool_tracker import ToolReading
from .ultrasound.frame_registration import RegistrationRecord


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class GuidanceState:
    """The state of guidance at `now_s`.

    Attributes:
        transform: (p_tracker, t) ↦ (p_mr, φ), from now on until something new is known.
        estimate: the pose in use with its covariance, or the last one while it is withheld; None before any.
        pose_age_s: time since a heart beat confirmed the pose; infinite before the first.
        tre_bound_mm: 95 % bound on the error of the pose in use over the heart; NaN before the first.
        doubt: why the pose is suspended; None while it is not.
        tip_seen: where ultrasound shows the tool's tip; None where it does not.
        registration: the last one that ended, with its evidence; None before the first.
        model_phase: place in the model's cycle; NaN where the phase is not locked.
        tool: the tool's tip, or why it is not known.
        calibrations: that are in use.
        status: of the fixtures; anything but OK goes with no wanted force, but for the worst-phase walls of
            NO_PHASE.
        wanted_n: (3,) force of the fixtures, frame "tracker".
        distance_mm: signed distance of the primary fixture, positive inside; at NO_PHASE of the first wall at
            its worst phase; else NaN unless OK.
        gradient: (3,) of that distance, frame "tracker".
        rate_mm_per_cycle: its change with the model's phase; zero at NO_PHASE, NaN of a path.
        conflict: fixtures oppose each other.
        margin_mm: (k,) by which each fixture is widened; what a servo is told (`ServoInputs.margin_mm`).
        supervised: the force to send, and the supervisor's state with what it found.
        rearmed: answer to the operator's last re-arm; None before any.
    """

    now_s: float
    transform: PoseAndPhase
    estimate: PoseEstimate | None
    pose_age_s: float
    tre_bound_mm: float
    doubt: Doubt | None
    tip_seen: TipSighting | None
    registration: RegistrationRecord | None
    model_phase: float
    tool: ToolReading
    calibrations: CalibrationsInUse
    status: Status
    wanted_n: FloatArray
    distance_mm: float
    gradient: FloatArray
    rate_mm_per_cycle: float
    conflict: bool
    margin_mm: FloatArray
    supervised: SupervisedForce
    rearmed: RearmAnswer | None

    @property
    def phase(self) -> PhaseReading:
        """Phase of the beat, its standard deviation, predicted RR and state."""
        return self.transform.phase.at(self.now_s)

    @property
    def distance_sigma_mm(self) -> float:
        """Standard deviation of the distance by those of pose and phase; NaN where either is not known."""
        place = self.transform.at(self.tool.tip_tracker_mm[None], self.now_s)
        if self.transform.pose is None:
            return nan
        gradient_mr = self.transform.pose.at(self.now_s).rotation @ self.gradient
        return float(place.distance_sigma_mm(gradient_mr[None], np.array([self.rate_mm_per_cycle]))[0])

    @property
    def force_n(self) -> FloatArray:
        """(3,) N, frame "tracker": the force to send."""
        return self.supervised.force_n

    @property
    def supervisor(self) -> SupervisorState:
        return self.supervised.state

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the force is not given in full, a sentence each; none where it is."""
        found = self.supervised.sentences
        if self.supervisor is SupervisorState.LATCHED and self.rearmed is not None:
            found += (self.rearmed.value,)
        if self.doubt is not None:
            found += (self.doubt.sentence,)
        if self.registration is not None and not self.registration.usable:
            found += (f"last registration: {self.registration.reason}",)
        return found
