"""One registration on the whole of a recording, offline: every R peak and every gated frame at once."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import stream_recording
from dvf_ig.core import DvfModel, NoOverlapError, Progress, Rigid, Scenario, untold
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.intake.problems import concerning
from dvf_ig.intake.start import landmark_fit, landmark_prior, require_start, start_pose, touched_points
from dvf_ig.registration import RegistrationResult, TouchedSurface, against_touched
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


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRegistration:
    """A registration of a recording that can begin: calibrated, gated, with enough frames and a start."""

    scenario: Scenario
    recording: UltrasoundRecording
    frames: GatedFrames
    start: Rigid

    def register(
        self,
        *,
        seed: int = 0,
        warm: bool = False,
        clock: Clock = perf_counter,
        progress: Progress | None = None,
    ) -> RegistrationResult:
        """Register the frames, against all that was touched on the patient.

        Args:
            warm: rely on the start and skip displaced starts.
        Raises:
            NoOverlapError: too few frames can be compared with the model.
        """
        scenario = self.scenario
        model = self.recording.heart.model
        touched = touched_points(scenario, model)
        result = register_frames(
            self.recording,
            self.frames,
            self.start,
            seed=seed,
            clock=clock,
            warm=warm,
            landmarks=landmark_prior(scenario),
            touched=touched,
            progress=progress,
        )
        surface = None if touched is None else TouchedSurface(touched, model)
        return against_touched(result, landmark_fit(scenario), surface)


def prepare_registration(
    scenario: Scenario,
    *,
    model: DvfModel | None = None,
    heart: Heart | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> PreparedRegistration:
    """Do all that comes before the search for the pose, so that what prevents it is known.

    Raises:
        NoOverlapError: too few frames can be compared with the model.
        InvalidInputError, QualityGateError: as `run_replay`; or the start cannot be used.
    """
    recording = recorded_ultrasound(scenario, model=model, heart=heart, seed=seed, progress=progress)
    with concerning("start"):
        start = start_pose(scenario, recording.heart, seed)
    frames = every_frame(recording)
    if not frames.enough:
        raise NoOverlapError(frames.shortage, key="ultrasound")
    return PreparedRegistration(scenario, recording, frames, start)


def explain_refusal(
    prepared: PreparedRegistration, refused: RegistrationResult, *, seed: int = 0
) -> str | None:
    """Say which single mistake in preparing the recording would explain a refused registration.

    Each is undone, and the registration tried again without displaced starts; None if none then passes its
    checks.

    Args:
        refused: what was refused.
    """
    for sentence, undone in _undone(prepared, refused):
        try:
            result = undone.register(seed=seed, warm=True)
        except NoOverlapError:
            continue
        if result.stop.usable:
            return sentence
    return None


def _undone(
    prepared: PreparedRegistration, refused: RegistrationResult
) -> Iterator[tuple[str, PreparedRegistration]]:
    recording, start = prepared.recording, prepared.start
    for axis, side in ((2, "left to right"), (1, "top to bottom")):
        images = np.ascontiguousarray(np.flip(recording.images, axis=axis))
        seen = replace(recording.ultrasound, images=images)
        mirrored = replace(recording, ultrasound=seen, fan=None)  # the sector is found in the images
        yield (
            f"with its images mirrored {side} the registration passes its checks: they are stored in another "
            "orientation than the probe was calibrated with (UltrasoundImageOrientation)",
            replace(prepared, recording=mirrored),
        )
    flip = np.diag([-1.0, -1.0, 1.0])
    flipped = Rigid(start.target, start.source, flip @ start.rotation, flip @ start.translation_mm)
    yield (
        "with x and y of the start reversed the registration passes its checks: the start is in RAS where it "
        "says LPS, or the reverse",
        replace(prepared, start=flipped),
    )
    offset, calibrations = refused.evidence.image_offset, recording.calibrations
    if offset is None:
        return
    image_map = replace(calibrations.probe_from_image, rigid=offset.probe_from_image)
    moved = replace(recording, calibrations=replace(calibrations, probe_from_image=image_map))
    yield (
        f"{offset.sentence} (the registration then passes its checks)",
        replace(prepared, recording=moved, start=offset.pose),
    )


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
    prepared = prepare_registration(
        recorded, model=model, heart=heart, seed=seed, progress=lambda f: report(0.6 * f)
    )
    return prepared.register(seed=seed, clock=clock, progress=lambda f: report(0.6 + 0.4 * f))


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
