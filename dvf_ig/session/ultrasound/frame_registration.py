"""Registration of gated ultrasound frames: what is asked for, how it is made, and what became of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from dvf_ig.cardiac import RPeak
from dvf_ig.core import NoOverlapError, Rigid
from dvf_ig.registration import (
    SWEEP,
    USUAL_PLACEMENT,
    LandmarkPrior,
    Level,
    RegistrationResult,
    TouchedSurface,
    UltrasoundImages,
    boundary_points,
    register,
)
from dvf_ig.session.heart import COARSE_PITCH_MM, FINE_PITCH_MM
from dvf_ig.session.refusal import Refused

from .gated_frames import GatedFrames, UltrasoundRecording, slices_of, ultrasound_mask


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationRequest:
    """A registration that is asked for at `until_s`.

    Attributes:
        from_s, until_s: event times of the frames to register.
        start: pose to begin at; `warm` relies on it and skips displaced starts.
        prior: touched landmarks that the pose must also agree with.
        peaks: R peaks that were known when it was asked for.
    """

    from_s: float
    until_s: float
    start: Rigid
    warm: bool
    prior: LandmarkPrior | None
    peaks: tuple[RPeak, ...]

    def record(
        self,
        frames: GatedFrames | None,
        result: RegistrationResult | None = None,
        failure: str | None = None,
    ) -> "RegistrationRecord":
        """Record what became of it, not in use yet."""
        return RegistrationRecord(self.until_s, inf, frames, result, failure)


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationRecord:
    """When a registration was asked for and could be used, and what became of it.

    Attributes:
        asked_s: when it was started.
        ready_s: from when its result could be used.
        frames: the gated ultrasound; None if none had arrived.
        result: None if too few frames passed the gate, or it failed.
        failure: why it failed, as a user reads it.
        refused: why it is not used though its own evidence would allow it; None if it is.
    """

    asked_s: float
    ready_s: float
    frames: GatedFrames | None
    result: RegistrationResult | None
    failure: str | None = None
    refused: Refused | None = None

    @property
    def usable(self) -> bool:
        return self.result is not None and self.result.stop.usable and self.refused is None

    @property
    def reason(self) -> str:
        """How it ended, as a user reads it."""
        if self.refused is not None:
            return self.refused.sentence
        if self.result is not None:
            return self.result.sentence
        if self.failure is not None or self.frames is None:
            return self.failure or "no ultrasound"
        return self.frames.shortage


def register_frames(
    recording: UltrasoundRecording,
    frames: GatedFrames,
    start: Rigid,
    *,
    seed: int,
    clock: Callable[[], float],
    warm: bool = False,
    prior: LandmarkPrior | None = None,
    landmarks: Rigid | None = None,
    touched: TouchedSurface | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """Register gated frames to the model.

    Args:
        start: pose to begin at; `warm` relies on it and skips displaced starts.
        seed: of the displaced starts.
        prior, landmarks, touched: see `registration.register`.
    Raises:
        InvalidInputError: the recording has no images.
        NoOverlapError: too few frames passed the gate; says why.
    """
    return register(
        images_of_frames(recording, frames, clock, warm=warm),
        recording.heart,
        start,
        rng=np.random.default_rng(seed),
        clock=clock,
        prior=prior,
        landmarks=landmarks,
        touched=touched,
        progress=progress,
    )


def images_of_frames(
    recording: UltrasoundRecording, frames: GatedFrames, clock: Callable[[], float], *, warm: bool
) -> UltrasoundImages:
    """Prepare the used frames at the two pitches of a registration.

    Raises:
        InvalidInputError, NoOverlapError: as `register_frames`.
    """
    if not frames.enough:
        raise NoOverlapError(frames.shortage)
    began, heart, mask = clock(), recording.heart, ultrasound_mask(recording, frames)
    coarse, fine = (
        Level(slices_of(recording, frames, mask, pitch_mm=pitch), pitch)
        for pitch in (COARSE_PITCH_MM, FINE_PITCH_MM)
    )
    boundary = None if heart.surface is None else boundary_points(fine.slices)
    options = SWEEP if heart.beats_update_pose else replace(SWEEP, kind=None)
    return UltrasoundImages(
        coarse,
        fine,
        boundary,
        _usual_rr_s(recording, frames),
        USUAL_PLACEMENT,
        replace(options, starts=0) if warm else options,
        clock() - began,
    )


def _usual_rr_s(recording: UltrasoundRecording, frames: GatedFrames) -> float:
    """Median interval of the R peaks around the used frames; the model's own if there are none."""
    begin, end = frames.event_s[frames.used][[0, -1]]
    peaks = np.array([p.t_s for p in recording.peaks])
    near = peaks[(peaks > begin - 2.0) & (peaks < end)]
    return float(np.median(np.diff(near))) if len(near) > 1 else recording.heart.model.timing.rr_s
