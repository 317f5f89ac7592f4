"""State of guidance at one moment, with the tick of the servo that follows from it."""

from dataclasses import dataclass

from dvf_ig.core import FloatArray, PhaseReading, Rigid, read_only_arrays
from dvf_ig.guidance import Hazard, PoseAndPhase, RearmAnswer, Status, SupervisedForce, SupervisorState
from dvf_ig.guidance.servo import ServoInputs, ServoTick
from dvf_ig.registration import PoseEstimate, TipSighting

from .breathing import BreathMoment
from .reasons import Doubt
from .setup import CalibrationsInUse
from .tool_tracker import ToolReading
from .ultrasound_registration import RegistrationRecord

OF_TRACKER = (
    Hazard.STALE_TOOL | Hazard.TOOL_LOST | Hazard.TOOL_FROZEN | Hazard.LATENCY_JUMP | Hazard.TOOL_CONTRADICTED
)
"""Hazards of a tracked tool; a haptic device's own encoders do not have them."""


OF_POSE = Hazard.NO_POSE | Hazard.POSE_CONTRADICTED | Hazard.BREATHING
"""Hazards that the motion in breathing may explain."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class GuidanceState:
    """State of guidance at `now_s`.

    Attributes:
        transform: (p_tracker, t) ↦ (p_mr, φ), from now on until something new is known.
        estimate: the pose in use with its covariance, or the last one while it is withheld; None before any.
        pose_age_s: time since a heart beat confirmed the pose; infinite before the first.
        pose_bound_mm: 95 % bound on the RMS error of the pose in use over the heart, or of the guarded walls
            where its shape is followed; NaN before the first.
        doubt: why the pose is suspended; None while it is not.
        breathing: why breathing withholds the pose or lets it serve at rest alone; None if it does neither.
        breath: where the heart is in the breath, as of the last sample of what follows it.
        tip_seen: where ultrasound shows the tool's tip; None if it does not.
        registration: the last one that ended, with its evidence; None before the first.
        model_phase: in the model's cycle; NaN if the phase is not locked.
        tool: the tool's tip, or why it is not known.
        calibrations: in use.
        hazards, tool_status, margin_mm: published to the session's servo now (`ServoInputs`).
        tick: of the session's servo at this moment.
        rearmed: answer to the operator's last re-arm; None before any.
    """

    now_s: float
    transform: PoseAndPhase
    estimate: PoseEstimate | None
    pose_age_s: float
    pose_bound_mm: float
    doubt: Doubt | None
    breathing: str | None
    breath: BreathMoment
    tip_seen: TipSighting | None
    registration: RegistrationRecord | None
    model_phase: float
    tool: ToolReading
    calibrations: CalibrationsInUse
    hazards: Hazard
    tool_status: Status
    margin_mm: FloatArray
    tick: ServoTick
    rearmed: RearmAnswer | None

    @property
    def phase(self) -> PhaseReading:
        """Phase of the beat, its standard deviation, predicted RR and state."""
        return self.transform.phase.at(self.now_s)

    def inputs(self, tracker_from_device: Rigid) -> ServoInputs:
        """Inputs of a separate servo with a haptic device, whose encoders measure where the tool is."""
        own = self.hazards & ~OF_TRACKER
        return ServoInputs(
            self.transform, self.now_s, tracker_from_device, hazards=own, margin_mm=self.margin_mm
        )

    @property
    def status(self) -> Status:
        """Status of the fixtures; all but OK, and NO_PHASE with its walls, want no force."""
        return self.tick.status

    @property
    def wanted_n(self) -> FloatArray:
        """(3,) N, frame "tracker": force by fixtures and passivity controller, before the supervisor."""
        return self.tick.wanted_n

    @property
    def distance_mm(self) -> float:
        """Signed distance of the primary fixture, positive inside (`ServoTick`)."""
        return self.tick.distance_mm

    @property
    def gradient(self) -> FloatArray:
        """(3,) of the distance, frame "tracker"."""
        return self.tick.gradient

    @property
    def distance_sigma_mm(self) -> float:
        """Standard deviation of the distance by those of pose and phase; NaN if either is not known."""
        return self.tick.sigma_mm

    @property
    def rate_mm_per_cycle(self) -> float:
        """Change of the distance with the model's phase; zero at NO_PHASE, NaN of a path."""
        return self.tick.rate_mm_per_cycle

    @property
    def conflict(self) -> bool:
        """Whether fixtures oppose each other."""
        return self.tick.conflict

    @property
    def supervised(self) -> SupervisedForce:
        """The force to send, and the supervisor's state with its hazards."""
        return self.tick.supervised

    @property
    def force_n(self) -> FloatArray:
        """(3,) N, frame "tracker": the force to send."""
        return self.tick.sent_n

    @property
    def supervisor(self) -> SupervisorState:
        return self.tick.state

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the force is not given in full, a sentence each; empty if it is."""
        sentences = self.supervised.sentences
        if self.supervisor is SupervisorState.LATCHED and self.rearmed is not None:
            sentences += (self.rearmed.value,)
        if self.hazards & OF_POSE and self.breathing is not None:
            sentences += (self.breathing,)
        return sentences + self.registration_reasons

    @property
    def registration_reasons(self) -> tuple[str, ...]:
        """Why the pose is suspended, and why the last registration was not used."""
        sentences: tuple[str, ...] = ()
        if self.doubt is not None:
            sentences += (self.doubt.sentence,)
        if self.registration is not None and not self.registration.usable:
            sentences += (f"last registration: {self.registration.reason}",)
        return sentences
