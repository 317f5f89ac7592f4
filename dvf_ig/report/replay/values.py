"""Content of the page of a replay: arrays over time, and ultrasound frames with the model in them."""

from collections.abc import Sequence
from dataclasses import dataclass

from dvf_ig.core.arrays import BoolArray, FloatArray, read_only_arrays
from dvf_ig.report.plane_overlay import PlaneOverlay


@dataclass(frozen=True, slots=True)
class RegistrationMark:
    """One registration: when its result was ready, whether it was usable, and why."""

    ready_s: float
    usable: bool
    reason: str


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatTrace:
    """Heart beats that were compared with the model under a pose.

    Attributes:
        decided_s: (b,) when the result took effect.
        in_use: (b,) the pose was in use; False if it was pending and no force was given.
        log_likelihood_ratio: (b,) improvement of the beat's best pose over the pose in use.
        tre_mm: (b,) mean target registration error of that beat's best pose; None without ground truth.
        limit: of the ratio, above which noise alone does not explain the improvement.
        suspended_s: begin and end of each time in which the pose was suspended.
    """

    decided_s: FloatArray
    in_use: BoolArray
    log_likelihood_ratio: FloatArray
    tre_mm: FloatArray | None
    limit: float
    suspended_s: Sequence[tuple[float, float]]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TickTrace:
    """Every tick of the force loop.

    Attributes:
        t_s: (n,) tracker clock.
        valid: (n,) a force was given.
        phase_valid: (n,) phase was LOCKED.
        force_n: (n,) size of the force given.
        distance_mm: (n,) of the tool tip from the surface, positive inside; NaN if unknown.
        true_force_n, true_distance_mm: (n,) ground truth of these; None without ground truth.
        phase_error_percent: (n,) of RR; None without ground truth.
    """

    t_s: FloatArray
    valid: BoolArray
    phase_valid: BoolArray
    force_n: FloatArray
    distance_mm: FloatArray
    true_force_n: FloatArray | None
    true_distance_mm: FloatArray | None
    phase_error_percent: FloatArray | None


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SupervisorTrace:
    """Inputs and states of the supervisor over time.

    Attributes:
        t_s: (n,) tick times.
        pose_age_s: (n,) since a heart beat confirmed the pose; infinite before the first.
        age_limit_s: (n,) age at which the pose would be withheld, by its age or by its bound.
        withheld: (begin, end, rule) of each time in which it was; s, and the rule in a few words.
        bands: name and colour of a state or hazard, with (n,) ticks in which it was active; only those that
            occurred.
    """

    t_s: FloatArray
    pose_age_s: FloatArray
    age_limit_s: FloatArray
    withheld: tuple[tuple[float, float, str], ...]
    bands: tuple[tuple[str, str, BoolArray], ...]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class EcgStrip:
    """A few seconds of the ECG or trigger, and the phase derived from it.

    Attributes:
        label: lead and unit of the samples, or a description of other content.
        ecg_t_s, ecg: (m,) samples of one lead; for a trigger the times of its pulses, and None.
        r_peaks_s: (k,) detected R peaks.
        t_s, phase: (n,) ticks and the phase estimated at each.
        phase_valid: (n,) LOCKED.
        true_phase: (n,); None without ground truth.
    """

    label: str
    ecg_t_s: FloatArray
    ecg: FloatArray | None
    r_peaks_s: FloatArray
    t_s: FloatArray
    phase: FloatArray
    phase_valid: BoolArray
    true_phase: FloatArray | None


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BreathLoop:
    """Motion of the heart's centre in breathing, along its main direction from rest, against a surrogate ρ.

    Attributes:
        surrogate: name of the channel or marker.
        rho, displacement_mm: (n,) of heart beats, in their middle.
        residual_mm, sigma_mm: (n,) measured less modelled, and its standard deviation.
        inspiration: (n,) ρ rises; otherwise it falls.
        course_rho, course_mm: (m,) of the model, over the mean of the last breaths; course_inspiration: (m,)
            as above.
        true_mm: (m,) of the ground truth; None without it.
        breaths: number of breaths it was learnt from; held_out_mm: its error in others, over the heart.
    """

    surrogate: str
    rho: FloatArray
    displacement_mm: FloatArray
    residual_mm: FloatArray
    sigma_mm: FloatArray
    inspiration: BoolArray
    course_rho: FloatArray
    course_mm: FloatArray
    course_inspiration: BoolArray
    true_mm: FloatArray | None
    breaths: int
    held_out_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class ReplayPage:
    """Content of the page.

    Attributes:
        scenario, patient_id, version: name of the scenario, patient, and program version.
        estimates: rows of quantity, estimate, error against the ground truth.
        registrations: in order.
        no_force: why no force was given, and what to do; None if one was given.
        without_force_s: time from the first pose on in which the force was released or withheld.
        lost: why no force could be given at the end of the recording; None if it could.
        warnings: contradictions between the recordings, one sentence each.
        overlays: frames of the last registration in use; may be empty.
        beats: None if no beat was compared.
        breath: None if forces did not follow a breath.
        ticks: every tick.
        supervisor: states and hazards.
        ecg: a few seconds in the middle.
    """

    scenario: str
    patient_id: str
    version: str
    estimates: Sequence[tuple[str, str, str]]
    registrations: Sequence[RegistrationMark]
    no_force: str | None
    without_force_s: float
    lost: str | None
    warnings: Sequence[str]
    overlays: Sequence[PlaneOverlay]
    beats: BeatTrace | None
    breath: BreathLoop | None
    ticks: TickTrace
    supervisor: SupervisorTrace
    ecg: EcgStrip
