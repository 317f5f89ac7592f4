"""One registration on the whole of a recording, offline: every R peak and every gated frame at once."""

from dataclasses import replace
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import stream_recording
from dvf_ig.core import DvfModel, Progress, Rigid, Scenario, untold
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.intake.start import landmark_pose, landmark_prior, require_start, start_pose, touched_surface
from dvf_ig.registration import RegistrationResult
from dvf_ig.session import (
    GatedFrames,
    Heart,
    UltrasoundRecording,
    build_heart,
    gate_recording,
    register_frames,
)

from .engine import Clock
from .preconditions import require_heart_beats, require_tracked_probe


def register_scenario(
    scenario: Scenario,
    start: Rigid | None = None,
    *,
    model: DvfModel | None = None,
    heart: Heart | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = perf_counter,
) -> RegistrationResult:
    """Register the whole recording, from the scenario's own start unless one is given.

    Args:
        model: as `run_replay`.
        heart: of the scenario's pre-operative data, if another recording of it was registered before.
    Raises:
        NoOverlapError: too few frames can be compared with the model.
        InvalidInputError, QualityGateError: as `run_replay`.
    """
    report = progress or untold
    recorded = scenario if start is None else replace(scenario, start=start)
    recording = recorded_ultrasound(
        recorded, model=model, heart=heart, seed=seed, progress=lambda f: report(0.6 * f)
    )
    return register_recording(
        recorded,
        recording,
        every_frame(recording),
        seed=seed,
        clock=clock,
        progress=lambda f: report(0.6 + 0.4 * f),
    )


def recorded_ultrasound(
    scenario: Scenario,
    *,
    model: DvfModel | None = None,
    heart: Heart | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> UltrasoundRecording:
    """Calibrate, find the R peaks and build the heart of a scenario.

    Raises:
        InvalidInputError: nothing to start from, an untracked probe, or too few heart beats.
    """
    require_start(scenario)
    require_tracked_probe(scenario)
    calibrations = calibrate(scenario, seed)
    peaks, _ = stream_recording(scenario.ecg)
    require_heart_beats(peaks, scenario)
    if heart is None:
        heart = build_heart(scenario.preop, model, progress=progress)
    return UltrasoundRecording(
        scenario.ultrasound, 0, scenario.fan, heart, peaks, calibrations.ultrasound, "two-segment"
    )


def every_frame(recording: UltrasoundRecording) -> GatedFrames:
    """Gate all frames of a recording."""
    return gate_recording(recording, from_s=-np.inf, until_s=np.inf)


def register_recording(
    scenario: Scenario,
    recording: UltrasoundRecording,
    frames: GatedFrames,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = perf_counter,
) -> RegistrationResult:
    """Register gated frames from the scenario's start, against all that was touched on the patient.

    Raises:
        NoOverlapError: too few frames can be compared with the model.
        InvalidInputError, QualityGateError: the start cannot be used.
    """
    heart = recording.heart
    return register_frames(
        recording,
        frames,
        start_pose(scenario, heart, seed),
        seed=seed,
        clock=clock,
        prior=landmark_prior(scenario),
        landmarks=landmark_pose(scenario),
        touched=touched_surface(scenario, heart.model),
        progress=progress,
    )
