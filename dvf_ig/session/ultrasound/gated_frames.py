"""Ultrasound frames that can be compared with the model: tracked, gated, and placed in its cycle."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvf_ig.cardiac import RetimeMode, RPeak, beat_phase, retime
from dvf_ig.core import (
    BoolArray,
    DvfModel,
    Fan,
    FloatArray,
    IntArray,
    InvalidInputError,
    TrackedSequence,
    read_only_arrays,
)
from dvf_ig.registration import (
    PHASE_WINDOW,
    Gated,
    SliceSet,
    TrackedImages,
    fan_mask_from_images,
    frame_information,
    gate_frames,
    prepare_slices,
    subsample,
)
from dvf_ig.session.calibrations import UltrasoundCalibration
from dvf_ig.session.heart import Heart

from .probe_motion import smoothed_poses

MAX_FRAMES, MIN_FRAMES = 48, 16
"""Most and fewest frames of one registration."""


@dataclass(frozen=True, slots=True, eq=False)
class UltrasoundRecording:
    """Tracked ultrasound, and what places it in space and in the cardiac cycle.

    Attributes:
        ultrasound: frames with tracker_from_probe.
        first_number: running number of its first frame since the stream began.
        fan: the insonified sector, where the scanner's geometry is known.
        heart: the model and channels that it is compared with.
        peaks: R peaks in time order.
        calibrations: latency and image calibration.
        retiming: how the beat is mapped to the model's cycle.
    """

    ultrasound: TrackedSequence
    first_number: int
    fan: Fan | None
    heart: Heart
    peaks: tuple[RPeak, ...]
    calibrations: UltrasoundCalibration
    retiming: RetimeMode

    @property
    def images(self) -> NDArray[np.uint8]:
        """(n, rows, columns).

        Raises:
            InvalidInputError: the recording has no images.
        """
        if self.ultrasound.images is None:
            raise InvalidInputError("the ultrasound recording has no images; registration needs them")
        return self.ultrasound.images


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class GatedFrames:
    """Ultrasound frames that can be compared with the model at one moment.

    Indices count from `first`, the first of the n frames in the time that was gated.

    Attributes:
        first: index of that frame in the recording; `first_number` its running number since the stream began.
        gated: which of the n frames were kept, and why others were not.
        used: (k,) the kept frames that are compared.
        event_s: (n,) event times on the tracker clock.
        model_phase: (n,) places in the model's cycle.
        rotations, translations_mm: (n, 3, 3), (n, 3) tracker_from_probe at the event times.
    """

    first: int
    first_number: int
    gated: Gated
    used: IntArray
    event_s: FloatArray
    model_phase: FloatArray
    rotations: FloatArray
    translations_mm: FloatArray

    @property
    def enough(self) -> bool:
        """Whether a registration can be made from them."""
        return len(self.used) >= MIN_FRAMES

    @property
    def shortage(self) -> str:
        """The sentence a user reads if they are not enough."""
        reasons = ", ".join(f"{count} {reason}" for reason, count in self.gated.rejected.items() if count)
        return (
            f"{len(self.used)} ultrasound frames can be compared with the model ({reasons}); "
            f"needed at least {MIN_FRAMES}: check probe tracking, ultrasound images and ECG"
        )


def gate_recording(
    recording: UltrasoundRecording,
    *,
    from_s: float,
    until_s: float,
    known_s: float | None = None,
    window: float = PHASE_WINDOW,
) -> GatedFrames:
    """Gate the frames whose event lies in [from_s, until_s).

    Args:
        known_s: R peaks that had been detected by then place them; `until_s` unless given.
        window: see `registration.gate_frames`.
    """
    ultrasound = recording.ultrasound
    event_s = ultrasound.t_s + recording.calibrations.lag_s
    first, last = (int(i) for i in np.searchsorted(event_s, [from_s, until_s]))
    here = slice(first, last)
    rotations, translations, tracked = smoothed_poses(ultrasound.stream("tracker", "probe"), event_s[here])
    by_s = until_s if known_s is None else known_s
    images, mm = recording.images, recording.calibrations.probe_from_image.scale_mm_per_px
    information = frame_information(
        images[here],
        sector_of(recording.fan, images[here]),
        (float(mm[1]), float(mm[0])),
        before=images[first - 1] if first else None,
    )
    known = np.array([p.t_s for p in recording.peaks if p.detected_at_s <= by_s])
    beat = beat_phase(known, event_s[here])
    model_phase = retimed(recording.heart.model, beat.phi, beat.rr_s, recording.retiming)
    gated = gate_frames(
        model_phase,
        recording.heart.channels.fractions,
        image_valid=ultrasound.image_valid[here],
        pose_valid=tracked,
        beat_valid=beat.regular,
        information=information,
        window=window,
    )
    used = gated.index[subsample(len(gated.index), MAX_FRAMES)]
    number = recording.first_number + first
    return GatedFrames(first, number, gated, used, event_s[here], model_phase, rotations, translations)


def retimed(model: DvfModel, phi: FloatArray, rr_s: FloatArray, mode: RetimeMode) -> FloatArray:
    """(n,) place in the model's cycle; moments without a known RR are placed as at the model's own rate."""
    known = np.where(np.isfinite(rr_s), rr_s, model.timing.rr_s)
    return retime(phi, known, model.timing.rr_s, model.es_fraction, mode=mode)


def ultrasound_mask(recording: UltrasoundRecording, frames: GatedFrames) -> BoolArray:
    """(rows, columns) sector, from the scanner's geometry, else from what the used frames show.

    Raises:
        InvalidInputError: the recording has no images.
    """
    return sector_of(recording.fan, recording.images[frames.first + frames.used])


def sector_of(fan: Fan | None, images: NDArray[np.uint8]) -> BoolArray:
    """(rows, columns) sector, from the scanner's geometry, else from what these images show."""
    if fan is not None:
        return fan_mask(fan, *images.shape[1:])
    return fan_mask_from_images(images)


@lru_cache(maxsize=4)
def fan_mask(fan: Fan, rows: int, columns: int) -> BoolArray:
    """Mask of a fan, kept because every beat asks for it."""
    mask = fan.mask(rows, columns)
    mask.setflags(write=False)
    return mask


def slices_of(
    recording: UltrasoundRecording, frames: GatedFrames, mask: BoolArray, *, pitch_mm: float
) -> SliceSet:
    """The used frames in the tracker's frame."""
    used = frames.used
    tracked = TrackedImages(
        recording.images[frames.first + used],
        frames.rotations[used],
        frames.translations_mm[used],
        frames.model_phase[used],
        frames.event_s[used],
    )
    return prepare_slices(
        tracked,
        mask,
        recording.calibrations.probe_from_image,
        pitch_mm=pitch_mm,
    )
