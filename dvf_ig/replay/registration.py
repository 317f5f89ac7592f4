"""One registration on the whole of a recording, offline: every R peak and every gated frame at once."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import stream_recording
from dvf_ig.core import DvfModel, Progress, Rigid, Scenario, Stop, untold
from dvf_ig.registration import RegistrationResult, SurfaceDisagreement
from dvf_ig.session import (
    GatedFrames,
    Heart,
    UltrasoundRecording,
    build_heart,
    gate_recording,
    landmark_disagreement_mm,
    register_frames,
)

from .calibrations import calibrate
from .engine import Clock
from .preconditions import require_heart_beats, require_tracked_probe
from .start import landmark_pose, landmark_prior, require_start, start_pose, touched_disagreement


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A registration, and what it was made from.

    Attributes:
        result: mr_from_tracker with its evidence.
        start: the coarse pose that it started from.
        landmarks: mr_from_tracker from touched landmarks; None where none were touched.
        touched: how far points touched on the surface lie from it; None where none were touched.
        frames: which frames were compared with the model, and why others were not.
        recording: they are part of, with R peaks, calibrations and heart.
    """

    result: RegistrationResult
    start: Rigid
    landmarks: Rigid | None
    touched: SurfaceDisagreement | None
    frames: GatedFrames
    recording: UltrasoundRecording


def register_scenario(
    scenario: Scenario,
    start: Rigid | None = None,
    *,
    model: DvfModel | None = None,
    heart: Heart | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = perf_counter,
) -> Registration:
    """One registration on the whole recording, from the scenario's own start unless one is given.

    It ends in DISAGREEMENT where landmarks or points of the surface were touched and lie elsewhere.

    Args:
        model: as `run_replay`.
        heart: of the scenario's pre-operative data, where another recording of it was registered before.
    Raises:
        NoOverlapError: too few frames can be compared with the model.
        InvalidInputError, QualityGateError: as `run_replay`.
    """
    report_progress = progress or untold
    if start is None:
        require_start(scenario)
    require_tracked_probe(scenario)
    calibrations = calibrate(scenario, seed)
    peaks, _ = stream_recording(scenario.ecg)
    require_heart_beats(peaks, scenario)
    if heart is None:
        heart = build_heart(scenario.preop, model, progress=lambda f: report_progress(0.6 * f))
    pose = start if start is not None else start_pose(scenario, heart, seed)
    recording = UltrasoundRecording(
        scenario.ultrasound, 0, scenario.fan, heart, peaks, calibrations.ultrasound, "two-segment"
    )
    frames = gate_recording(recording, from_s=-np.inf, until_s=np.inf)
    result = register_frames(
        recording,
        frames,
        pose,
        seed=seed,
        clock=clock,
        prior=landmark_prior(scenario),
        progress=lambda f: report_progress(0.6 + 0.4 * f),
    )
    landmarks = landmark_pose(scenario)
    touched = touched_disagreement(scenario, result.target_from_source, heart.model)
    off_mm = landmark_disagreement_mm(result.target_from_source, landmarks, heart.center_mm)
    if result.stop.usable and (off_mm is not None or (touched is not None and not touched.agrees)):
        result = result.refused(Stop.DISAGREEMENT)
    return Registration(result, pose, landmarks, touched, frames, recording)
