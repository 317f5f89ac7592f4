"""The replay on one screen: from raw recordings to a force a millisecond, in time order, never looking ahead.

    pre-op   build the distance model and the registration channels           Sections III, VI
    before   calibrate tool tip, probe image and latency                      calibration
    live     R peaks → phase, T_d → gate → register, update → pose and phase → force  Sections VI, VII

The ground truth is not read here; `score` does that with what this returns.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import PhaseTracking, track_phase
from dvf_ig.core import BoolArray, DvfModel, FloatArray, Rigid, Scenario, Stop, read_only_arrays
from dvf_ig.guidance import ForceSamples
from dvf_ig.registration import RegistrationResult, SliceThreads

from .beat_evaluation import BEAT_COMPUTE_S
from .calibrations import Calibrations, calibrate
from .forces import force_samples
from .frame_registration import landmark_pose, register_frames, start_pose
from .gated_frames import UltrasoundRecording, gate_recording, retimed
from .heart import Heart, build_heart
from .pose_history import Attempt, PoseHistory
from .pose_tracker import Timing, track_pose
from .preconditions import require_heart_beats, require_tracked_poses, tick_times
from .recorded_ultrasound import RecordedUltrasound
from .registration_monitor import RegistrationMonitor, landmark_disagreement_mm
from .schedule import pose_schedule, suspended_at
from .tool_tip import TipTrack, predict_tip

Clock = Callable[[], float]
"""Seconds of computing time, from any origin."""
Progress = Callable[[float], None]
"""Told the fraction that is done."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """Everything a replay estimated. Arrays have one row a tick.

    Attributes:
        start: coarse mr_from_tracker that registration started from.
        history: registrations, evaluated beats and what they did to the pose.
        poses: (time from which it was in use, mr_from_tracker), with the bounded motion between updates.
        tip: predicted tool tip.
        model_phase: (n,) retimed phase; valid where `phase_tracking.track.valid`.
        samples: force in frame "tracker", distance, gradient and status.
        valid: (n,) ticks with tracked tool, locked phase, a usable pose and the tool inside the model's box.
        seconds: computing time of the whole.
    """

    scenario: Scenario
    heart: Heart
    calibrations: Calibrations
    phase_tracking: PhaseTracking
    start: Rigid
    history: PoseHistory
    poses: tuple[tuple[float, Rigid], ...]
    tip: TipTrack
    model_phase: FloatArray
    samples: ForceSamples
    valid: BoolArray
    seconds: float

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        return self.history.attempts


def run_replay(
    scenario: Scenario,
    *,
    model: DvfModel | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = perf_counter,
) -> Replay:
    """Replay a scenario from raw streams to force.

    Args:
        model: this patient's fixture model, where it was built before; else it is built here.
        seed: of the random choices in calibration and registration.
        clock: times the computing; no estimate depends on it.
    Raises:
        InvalidInputError: a recording cannot be used (no heart beats, no tracked pose, …).
        QualityGateError: a calibration refused its recording.
    """
    report_progress = progress or (lambda _: None)
    began = clock()
    start = start_pose(scenario)
    require_tracked_poses(scenario)
    calibrations = calibrate(scenario, seed)
    report_progress(0.05)
    t_s = tick_times(scenario)
    phase_tracking = track_phase(scenario.ecg, t_s)
    require_heart_beats(phase_tracking, scenario)
    heart = build_heart(scenario.preop, model, progress=lambda f: report_progress(0.05 + 0.35 * f))
    recording = _recording(scenario, heart, phase_tracking, calibrations)
    monitor = RegistrationMonitor(heart.center_mm, landmark_pose(scenario))
    timing = Timing(_first_event_s(scenario, calibrations), float(t_s[-1]), BEAT_COMPUTE_S)
    with SliceThreads() as threads:
        ultrasound = RecordedUltrasound(recording, seed, clock, threads)
        history = track_pose(
            ultrasound, phase_tracking.peaks, monitor, start, timing, lambda f: report_progress(0.4 + 0.5 * f)
        )
    poses = pose_schedule(history.updates, heart.center_mm)
    track = phase_tracking.track
    model_phase = retimed(heart.model, track.phi, track.rr_s)
    tip = predict_tip(scenario.tool, calibrations.pivot.tip.xyz_mm[0], t_s)
    suspended = suspended_at(history.updates, t_s)
    samples, valid = force_samples(heart, poses, suspended, tip, model_phase, track.valid)
    report_progress(1.0)
    return Replay(
        scenario=scenario,
        heart=heart,
        calibrations=calibrations,
        phase_tracking=phase_tracking,
        start=start,
        history=history,
        poses=poses,
        tip=tip,
        model_phase=model_phase,
        samples=samples,
        valid=valid,
        seconds=clock() - began,
    )


def _recording(
    scenario: Scenario, heart: Heart, phase_tracking: PhaseTracking, calibrations: Calibrations
) -> UltrasoundRecording:
    lag_s, probe_from_image = calibrations.latency.lag_s, calibrations.probe.probe_from_image
    return UltrasoundRecording(scenario, heart, phase_tracking.peaks, lag_s, probe_from_image)


def _first_event_s(scenario: Scenario, calibrations: Calibrations) -> float:
    return float(scenario.ultrasound.t_s[0]) + calibrations.latency.lag_s


def register_scenario(
    scenario: Scenario,
    start: Rigid | None = None,
    *,
    model: DvfModel | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = perf_counter,
) -> RegistrationResult:
    """One registration on the whole recording, from the scenario's own start unless one is given.

    It ends in DISAGREEMENT where landmarks were touched and lie elsewhere (see `registration_monitor`).

    Args:
        model: as `run_replay`.
    Raises:
        NoOverlapError: too few frames can be compared with the model.
        InvalidInputError, QualityGateError: as `run_replay`.
    """
    report_progress = progress or (lambda _: None)
    pose = start if start is not None else start_pose(scenario)
    require_tracked_poses(scenario)
    calibrations = calibrate(scenario, seed)
    phase_tracking = track_phase(scenario.ecg, tick_times(scenario))
    require_heart_beats(phase_tracking, scenario)
    heart = build_heart(scenario.preop, model, progress=lambda f: report_progress(0.6 * f))
    recording = _recording(scenario, heart, phase_tracking, calibrations)
    result = register_frames(
        recording,
        gate_recording(recording, from_s=-np.inf, until_s=np.inf),
        pose,
        seed=seed,
        clock=clock,
        progress=lambda f: report_progress(0.6 + 0.4 * f),
    )
    off_mm = landmark_disagreement_mm(result.target_from_source, landmark_pose(scenario), heart.center_mm)
    disagrees = off_mm is not None and result.stop.usable
    return replace(result, stop=Stop.DISAGREEMENT) if disagrees else result
