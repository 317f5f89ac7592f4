"""One registration on the whole of a recording, offline: every R peak and every gated frame at once."""

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import stream_recording
from dvf_ig.core import DvfModel, Rigid, Scenario, Stop
from dvf_ig.registration import RegistrationResult
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
from .engine import Clock, Progress
from .preconditions import require_heart_beats, require_tracked_probe
from .start import landmark_pose, landmark_prior, require_start, start_pose, touched_disagreement


@dataclass(frozen=True, slots=True, eq=False)
class RecordingRegistration:
    """A registration, and what it was made from.

    Attributes:
        result: mr_from_tracker with its evidence.
        start: the coarse pose that it started from.
        recording: the ultrasound with R peaks, calibrations and heart.
        frames: which of its frames were compared.
    """

    result: RegistrationResult
    start: Rigid
    recording: UltrasoundRecording
    frames: GatedFrames


def register_scenario(
    scenario: Scenario,
    start: Rigid | None = None,
    *,
    model: DvfModel | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = perf_counter,
) -> RecordingRegistration:
    """One registration on the whole recording, from the scenario's own start unless one is given.

    It ends in DISAGREEMENT where landmarks or points of the surface were touched and lie elsewhere.

    Args:
        model: as `run_replay`.
    Raises:
        NoOverlapError: too few frames can be compared with the model.
        InvalidInputError, QualityGateError: as `run_replay`.
    """
    report_progress = progress or (lambda _: None)
    if start is None:
        require_start(scenario)
    require_tracked_probe(scenario)
    calibrations = calibrate(scenario, seed)
    peaks, _ = stream_recording(scenario.ecg)
    require_heart_beats(peaks, scenario)
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
    if _contradicted(scenario, result, heart):
        result = replace(result, stop=Stop.DISAGREEMENT)
    return RecordingRegistration(result, pose, recording, frames)


def _contradicted(scenario: Scenario, result: RegistrationResult, heart: Heart) -> bool:
    """Whether landmarks, or points touched on the surface, lie elsewhere than a usable pose puts them."""
    if not result.stop.usable:
        return False
    pose = result.target_from_source
    if landmark_disagreement_mm(pose, landmark_pose(scenario), heart.center_mm) is not None:
        return True
    touched = touched_disagreement(scenario, pose, heart.model)
    return touched is not None and not touched.agrees
