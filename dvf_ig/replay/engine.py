"""The replay on one screen: from raw recordings to a force a millisecond, in time order, never looking ahead.

    pre-op   build the distance model and the registration channels           Sections III, VI
    before   calibrate tool tip, probe image and latency                      calibration
    live     R peaks → phase, T_d → gate → register, track → pose and phase → force  Sections VI, VII

The planted truth is not read here; `score` does that with what this returns.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import MIN_BEATS, PhaseTracking, RPeak, track_phase
from dvf_ig.core import (
    BoolArray,
    DvfModel,
    FloatArray,
    IntArray,
    InvalidInputError,
    NoOverlapError,
    Rigid,
    Scenario,
    Stop,
    read_only_arrays,
)
from dvf_ig.guidance import Evaluator, ForceSamples, PoseAndPhase, Sigmoid, Status
from dvf_ig.registration import RegistrationResult

from .beat_evaluation import BEAT_COMPUTE_S, BeatSlices, beat_slices
from .calibrations import Rulers, calibrate
from .gated_frames import Sight, landmark_pose, locate, look, retimed, start_pose
from .heart import Heart, build_heart
from .pose_tracker import Attempt, Course, Eyes, follow
from .registration_monitor import Trust, disagreeing_landmarks
from .schedule import pose_schedule, withheld
from .ticks import TipTrack, predict_tip

RATE_HZ = 1000.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """Everything a replay estimated. Arrays have one row a tick.

    Attributes:
        start: coarse mr_from_tracker that registration started from.
        course: registrations, beats and what they did to the pose.
        poses: (time from which it was in use, mr_from_tracker), with the bounded motion between updates.
        tip: predicted tool tip.
        model_phase: (n,) retimed phase; valid where `tracking.track.valid`.
        samples: force in frame "tracker", distance, gradient and status.
        valid: (n,) ticks with tracked tool, locked phase, a usable pose and the tool inside the model's box.
    """

    scenario: Scenario
    heart: Heart
    rulers: Rulers
    tracking: PhaseTracking
    start: Rigid
    course: Course
    poses: tuple[tuple[float, Rigid], ...]
    tip: TipTrack
    model_phase: FloatArray
    samples: ForceSamples
    valid: BoolArray
    seconds: float

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        return self.course.attempts


def run_replay(
    scenario: Scenario,
    *,
    model: DvfModel | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Replay:
    """Replay a scenario from raw streams to force.

    Args:
        model: this patient's fixture model, where it was built before; else it is built here.
        seed: of the random choices in calibration and registration.
    Raises:
        InvalidInputError: a recording cannot be used (no heart beats, no tracked pose, …).
        QualityGateError: a calibration refused its recording.
    """
    tell = progress or (lambda _: None)
    began = perf_counter()
    start = start_pose(scenario)
    _refuse_untracked(scenario)
    rulers = calibrate(scenario, seed)
    tell(0.05)
    t_s = _tick_times(scenario)
    tracking = track_phase(scenario.ecg, t_s)
    _refuse_beatless(tracking, scenario)
    heart = build_heart(scenario.preop, model, progress=lambda f: tell(0.05 + 0.35 * f))
    course = _followed(
        scenario, heart, rulers, tracking.peaks, start, float(t_s[-1]), seed, lambda f: tell(0.4 + 0.5 * f)
    )
    track = tracking.track
    model_phase = retimed(heart.model, track.phi, track.rr_s)
    tip = predict_tip(scenario.tool, rulers.pivot.tip.xyz_mm[0], t_s)
    poses = pose_schedule(course.updates, heart.center_mm)
    samples, valid = _forces(heart, poses, withheld(course.updates, t_s), tip, model_phase, track.valid)
    tell(1.0)
    return Replay(
        scenario=scenario,
        heart=heart,
        rulers=rulers,
        tracking=tracking,
        start=start,
        course=course,
        poses=poses,
        tip=tip,
        model_phase=model_phase,
        samples=samples,
        valid=valid,
        seconds=perf_counter() - began,
    )


def _tick_times(scenario: Scenario) -> FloatArray:
    """Every millisecond in which ECG and tool were both recorded."""
    ecg_s = scenario.ecg.t_s
    begin = max(float(ecg_s[0]), float(scenario.tool.t_s[0]))
    end = min(float(ecg_s[-1]), float(scenario.tool.t_s[-1]))
    count = int((end - begin) * RATE_HZ)
    if count < RATE_HZ:
        raise NoOverlapError(
            f"ECG ({ecg_s[0]:.1f} to {ecg_s[-1]:.1f} s) and tool ({scenario.tool.t_s[0]:.1f} to "
            f"{scenario.tool.t_s[-1]:.1f} s) share less than a second; they must be on one clock"
        )
    return begin + np.arange(count) / RATE_HZ


def _refuse_untracked(scenario: Scenario) -> None:
    probe = scenario.ultrasound.stream("tracker", "probe")
    for stream, name in ((probe, "ultrasound.igs.mha"), (scenario.tool, "tool.igs.mha")):
        if not stream.valid.any():
            raise InvalidInputError(
                f"{name}: none of the {len(stream)} poses of {stream.name} has status OK; "
                "check the line of sight and record again"
            )


def _refuse_beatless(tracking: PhaseTracking, scenario: Scenario) -> None:
    if len(tracking.peaks) < MIN_BEATS:
        ecg = scenario.ecg
        raise InvalidInputError(
            f"the ECG has {len(tracking.peaks)} R peaks in {len(ecg) / ecg.rate_hz:.0f} s on lead(s) "
            f"{', '.join(ecg.leads)}, needed at least {MIN_BEATS}; check the electrodes and the lead"
        )


def _followed(
    scenario: Scenario,
    heart: Heart,
    rulers: Rulers,
    peaks: tuple[RPeak, ...],
    start: Rigid,
    end_s: float,
    seed: int,
    tell: Callable[[float], None],
) -> Course:
    lag_s, probe_from_image = rulers.latency.lag_s, rulers.probe.probe_from_image

    def register(
        from_s: float, until_s: float, pose: Rigid, warm: bool
    ) -> tuple[Sight, RegistrationResult | None, str]:
        sight = look(scenario, heart, peaks, lag_s, from_s=from_s, until_s=until_s)
        try:
            return (
                sight,
                locate(scenario, heart, sight, probe_from_image, pose, seed=seed, warm=warm),
                "",
            )
        except NoOverlapError as error:
            return sight, None, str(error)

    def beat(last: int) -> BeatSlices | None:
        return beat_slices(scenario, heart, peaks, last, lag_s, probe_from_image)

    return follow(
        Eyes(register, beat),
        peaks,
        Trust(heart.center_mm, landmark_pose(scenario)),
        start,
        begin_s=float(scenario.ultrasound.t_s[0]) + lag_s,
        end_s=end_s,
        decide_s=BEAT_COMPUTE_S,
        tell=tell,
    )


def _forces(
    heart: Heart,
    poses: tuple[tuple[float, Rigid], ...],
    doubtful: BoolArray,
    tip: TipTrack,
    model_phase: FloatArray,
    phase_valid: BoolArray,
) -> tuple[ForceSamples, BoolArray]:
    """Force at every tick through the pose then in use, in frame "tracker", and which ticks were valid."""
    evaluator = Evaluator(heart.model, Sigmoid())
    begins = np.searchsorted(tip.t_s, [start_s for start_s, _ in poses], side="left")
    posed = ~doubtful
    refusal = np.where(~posed, Status.NO_POSE, np.where(phase_valid, Status.STALE_TOOL, Status.NO_PHASE))
    valid = posed & phase_valid & tip.valid
    n = len(tip.t_s)
    force, gradient = np.zeros((n, 3)), np.full((n, 3), np.nan)
    distance, status = np.full(n, np.nan), refusal.astype(np.int64)
    for (_, mr_from_tracker), here in zip(poses, _pieces(begins, n), strict=True):
        part = PoseAndPhase(mr_from_tracker).evaluate(
            evaluator, tip.tip_tracker_mm[here], model_phase[here], valid[here], refusal=refusal[here]
        )
        force[here], gradient[here] = part.force_n, part.gradient
        distance[here], status[here] = part.distance_mm, part.status
    return ForceSamples("tracker", force, distance, gradient, status), status == Status.OK


def _pieces(begins: IntArray, n: int) -> list[slice]:
    """From each beginning to the next, the last to `n`."""
    return [slice(int(a), int(b)) for a, b in itertools.pairwise([*begins, n])]


def register_scenario(
    scenario: Scenario,
    start: Rigid | None = None,
    *,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """One registration on the whole recording, from the scenario's own start unless one is given.

    It ends in DISAGREEMENT where landmarks were touched and lie elsewhere (see `trust`).

    Raises:
        NoOverlapError: too few frames can be compared with the model.
        InvalidInputError, QualityGateError: as `run_replay`.
    """
    tell = progress or (lambda _: None)
    pose = start if start is not None else start_pose(scenario)
    _refuse_untracked(scenario)
    rulers = calibrate(scenario, seed)
    tracking = track_phase(scenario.ecg, _tick_times(scenario))
    _refuse_beatless(tracking, scenario)
    heart = build_heart(scenario.preop, progress=lambda f: tell(0.6 * f))
    sight = look(scenario, heart, tracking.peaks, rulers.latency.lag_s, from_s=-np.inf, until_s=np.inf)
    result = locate(
        scenario,
        heart,
        sight,
        rulers.probe.probe_from_image,
        pose,
        seed=seed,
        progress=lambda f: tell(0.6 + 0.4 * f),
    )
    doubt = disagreeing_landmarks(result.mr_from_tracker, landmark_pose(scenario), heart.center_mm)
    return replace(result, stop=Stop.DISAGREEMENT) if doubt and result.stop.usable else result
