"""Registration of ultrasound to the model: of gated tracked frames, and of gated 3-D volumes."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from dvf_ig.cardiac import RPeak, beat_phase
from dvf_ig.core import (
    DvfModel,
    FloatArray,
    InvalidInputError,
    NoOverlapError,
    Rigid,
    Stop,
    TouchedPoints,
    TrackedVolume,
    VolumeSeries,
    phase_distance,
)
from dvf_ig.registration import (
    PHASE_WINDOW,
    SWEEP,
    USUAL_PLACEMENT,
    VOLUME_SMOOTHING_MM,
    LandmarkPrior,
    Level,
    ProbePoses,
    RegistrationResult,
    UltrasoundImages,
    boundary_points,
    channels_from_mr,
    images_of_volumes,
    register,
)

from .gated_frames import GatedFrames, UltrasoundRecording, retimed, slices_of, ultrasound_mask
from .heart import COARSE_PITCH_MM, FINE_PITCH_MM, Heart
from .reasons import Refused

_LOG = logging.getLogger(__name__)
OVERLAP_STEP = 6
"""Every sixth voxel along each axis is tested for overlap."""

# ------------------------------------------------------------------ tracked frames


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationRequest:
    """Frames to register, and where to begin; requested at `until_s`.

    Attributes:
        from_s, until_s: event times of the frames.
        start: pose to begin at; `warm` relies on it and skips displaced starts.
        prior: touched landmarks.
        peaks: R peaks that were known at the request.
        touched: points touched on the heart's surface, as long as the patient has not moved.
    """

    from_s: float
    until_s: float
    start: Rigid
    warm: bool
    prior: LandmarkPrior | None
    peaks: tuple[RPeak, ...]
    touched: TouchedPoints | None = None

    def record(
        self, frames: GatedFrames | None, result: RegistrationResult | None = None, failure: str | None = None
    ) -> "RegistrationRecord":
        """Record the outcome, not in use yet."""
        return RegistrationRecord(self.from_s, self.until_s, inf, frames, result, failure)


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationRecord:
    """Outcome of a registration.

    Attributes:
        from_s: event time from which its frames were taken.
        asked_s: when it was requested.
        ready_s: from when its result could be used.
        frames: the gated ultrasound; None if none had arrived.
        result: None if too few frames passed the gate, or it failed.
        failure: why it failed, a sentence for the user.
        refused: why it is not used although its own evidence would allow it; None if it is.
    """

    from_s: float
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
    def renews(self) -> bool:
        """Whether it may renew a pose in use near it, though it must not begin one."""
        return self.result is not None and self.result.stop is Stop.UNBOUNDED and self.refused is None

    @property
    def reason(self) -> str:
        """Outcome as a sentence for the user."""
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
    landmarks: LandmarkPrior | None = None,
    touched: TouchedPoints | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """Register gated frames to the model.

    Args:
        start: pose to begin at; `warm` relies on it and skips displaced starts.
        seed: of the displaced starts.
        landmarks, touched: see `registration.register`.
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
    follows = heart.beats_update_pose or heart.covered is not None
    options = SWEEP if follows else replace(SWEEP, kind=None)
    return UltrasoundImages(
        coarse,
        fine,
        boundary,
        _usual_rr_s(recording, frames),
        USUAL_PLACEMENT,
        replace(options, starts=0) if warm else options,
        clock() - began,
        None if warm else _probe_poses(recording, frames),
    )


def _probe_poses(recording: UltrasoundRecording, frames: GatedFrames) -> ProbePoses:
    used, calibrated = frames.used, recording.calibrations.probe_from_image
    middle = calibrated.apply_pixels(0.5 * np.array([recording.images.shape[:0:-1]]))
    return ProbePoses(
        frames.rotations[used], frames.translations_mm[used], calibrated.rigid, middle.xyz_mm[0]
    )


def _usual_rr_s(recording: UltrasoundRecording, frames: GatedFrames) -> float:
    """Return the median interval of the R peaks around the used frames; the model's own without any."""
    begin, end = frames.event_s[frames.used][[0, -1]]
    peaks = np.array([p.t_s for p in recording.peaks])
    near = peaks[(peaks > begin - 2.0) & (peaks < end)]
    return float(np.median(np.diff(near))) if len(near) > 1 else recording.heart.model.timing.rr_s


# ------------------------------------------------------------------ gated volumes


def model_phase_at(model: DvfModel, peaks: Sequence[RPeak], t_s: float) -> float:
    """Compute the model phase of an image from the R peaks around its time.

    Systole is retimed as for tracked frames ("two-segment", see `cardiac.retime`).

    Args:
        peaks: in time order.
        t_s: on the clock of the ECG.
    Raises:
        InvalidInputError: no R peak before or after it, or an irregular beat.
    """
    peaks_s = np.array([peak.t_s for peak in peaks])
    beat = beat_phase(peaks_s, np.array([t_s]))
    if not np.isfinite(beat.rr_s[0]):
        span = f"{peaks_s[0]:.2f} to {peaks_s[-1]:.2f} s" if len(peaks_s) else "none"
        raise InvalidInputError(
            f"an ultrasound volume of {t_s:g} s lies in no heart beat of the ECG (R peaks: {span}); both "
            "must be on one clock"
        )
    if not beat.regular[0]:
        raise InvalidInputError(
            f"an ultrasound volume of {t_s:g} s was taken in or after an irregular beat, whose phase in the "
            "model's cycle is unknown; leave it out"
        )
    return float(retimed(model, beat.phi, beat.rr_s, "two-segment")[0])


def register_gated_volumes(
    volumes: Sequence[TrackedVolume],
    heart: Heart,
    start: Rigid,
    *,
    mr: VolumeSeries | None,
    seed: int,
    clock: Callable[[], float],
    landmarks: LandmarkPrior | None = None,
) -> RegistrationResult:
    """Register gated volumes to the model's phases nearest to theirs.

    Args:
        heart: from `build_heart`, with `mr` if that is known.
        start: mr_from_tracker to begin at.
        mr: the 4-D grey levels; None if the model alone is known.
        seed: of the displaced starts.
        clock: seconds from any origin, for the result's `seconds`.
        landmarks: see `registration.register`.
    Raises:
        InvalidInputError: no volume, or nothing insonified.
        NoOverlapError: at the start pose no volume reaches the model.
    """
    _require_overlap(volumes, heart, start)
    return register(
        images_of_volumes(volumes, grey=mr is not None, clock=clock),
        _as_volumes_see(heart, volumes, mr),
        start,
        rng=np.random.default_rng(seed),
        clock=clock,
        landmarks=landmarks,
    )


def _as_volumes_see(heart: Heart, volumes: Sequence[TrackedVolume], mr: VolumeSeries | None) -> Heart:
    """Return the heart with MR smoothed as volumes need it, at the phases in use alone."""
    phases = np.array([volume.model_phase for volume in volumes])
    nearest = heart.channels.nearest_phase(phases)
    _warn_of_distant_phases(phases, heart.channels.fractions[nearest])
    if mr is None:
        return heart
    used = np.unique(nearest).tolist()
    channels = channels_from_mr(mr, smoothing_mm=VOLUME_SMOOTHING_MM, phases=used)
    return replace(heart, channels=channels)


def _warn_of_distant_phases(phases: FloatArray, nearest: FloatArray) -> None:
    for phase, fraction in zip(phases, nearest, strict=True):
        apart = float(phase_distance(np.array([fraction]), np.array([phase]))[0, 0])
        if apart > PHASE_WINDOW:
            _LOG.warning(
                "an ultrasound volume at %.3f of the model's cycle is compared with its phase at %.3f, "
                "%.1f %% of the cycle away",
                phase,
                fraction,
                100 * apart,
            )


def _require_overlap(volumes: Sequence[TrackedVolume], heart: Heart, start: Rigid) -> None:
    """Raise NoOverlapError if no insonified voxel is within the model's image at the start."""
    grid = heart.channels.grid
    for volume in volumes:
        seen = OVERLAP_STEP * np.argwhere(volume.mask.values[::OVERLAP_STEP, ::OVERLAP_STEP, ::OVERLAP_STEP])
        mr_from_image = start @ volume.tracker_from_image
        index = grid.to_index(mr_from_image.apply_array(volume.image.grid.to_mm(seen.astype(np.float64))))
        if grid.holds(index).any():
            return
    raise NoOverlapError(
        "at the start pose no ultrasound volume reaches the model; check that the start is mr_from_tracker "
        "and that the volumes' coordinates are the tracker's"
    )
