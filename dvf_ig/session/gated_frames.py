"""Ultrasound frames that can be compared with the model: tracked, gated, and placed in its cycle.

The probe's pose at the moment of an image comes from the poses tracked around it (`smoothed_poses`). A hand
moves smoothly over half a second, a tracker's noise is new in every sample. So the pose is that of a
quadratic in time, fitted to POSES neighbouring samples (local regression, Cleveland 1979; rotations as
rotation vectors about the interpolated pose). If the hand was quicker than that, which shows as a misfit
beyond the noise, the interpolated pose is used.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvf_ig.cardiac import RetimeMode, RPeak, beat_phase, retime
from dvf_ig.core import (
    BoolArray,
    DvfModel,
    Fan,
    FloatArray,
    IntArray,
    InvalidInputError,
    PoseStream,
    Rigid,
    TrackedSequence,
    read_only_arrays,
)
from dvf_ig.core.recordings.stream import MAX_GAP_S
from dvf_ig.registration import (
    PHASE_WINDOW,
    Gated,
    PoseChart,
    SliceSet,
    TrackedImages,
    fan_mask_from_images,
    frame_information,
    gate_frames,
    prepare_slices,
    subsample,
)

from .breathing_motion import FrameBreathing, moved_to_rest
from .heart import Heart
from .setup import UltrasoundCalibration

MAX_FRAMES, MIN_FRAMES = 48, 16
"""Most and fewest frames of one registration."""
POSES = 13
"""One second at 12 Hz: a noise of 1 mm falls to 0.4 mm in the middle, a sweep of 40° in 9 s is bent by less
than 0.05 mm."""
DEGREE = 2
REACH_MM = 100.0
"""Converts rotation to mm: distance from the probe to the heart."""
MISFIT = 2.0
"""Residual variance over that of the noise, from third differences, above which the fit is not used."""
MEDIAN_OF_SQUARES = 0.455
"""Median over mean of the squares of Gaussian numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class UltrasoundRecording:
    """Tracked ultrasound, and the values that place it in space and in the cardiac cycle.

    Attributes:
        ultrasound: frames with tracker_from_probe.
        first_number: running number of its first frame since the stream began.
        fan: the insonified sector, where the scanner's geometry is known.
        heart: the model and channels that it is compared with.
        peaks: R peaks in time order.
        calibrations: latency and image calibration.
        retiming: how the beat is mapped to the model's cycle.
        breathing: at the event time of each frame; None if nothing follows the breath.
        tested: pose at which the frames are moved to the heart at rest.
    """

    ultrasound: TrackedSequence
    first_number: int
    fan: Fan | None
    heart: Heart
    peaks: tuple[RPeak, ...]
    calibrations: UltrasoundCalibration
    retiming: RetimeMode
    breathing: FrameBreathing | None = None
    tested: Rigid | None = None

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
        model_phase: (n,) phases in the model's cycle.
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
        """Whether there are enough for a registration."""
        return len(self.used) >= MIN_FRAMES

    @property
    def shortage(self) -> str:
        """Sentence that a user reads if they are not enough."""
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
    every_breath: bool = False,
) -> GatedFrames:
    """Gate the frames whose event lies in [from_s, until_s).

    Args:
        known_s: R peaks that had been detected by then place them; `until_s` unless given.
        window: see `registration.gate_frames`.
        every_breath: also keep frames whose place in the breath is not understood yet.
    """
    ultrasound = recording.ultrasound
    event_s = ultrasound.t_s + recording.calibrations.lag_s
    first, last = (int(i) for i in np.searchsorted(event_s, [from_s, until_s]))
    here = slice(first, last)
    rotations, translations, tracked = smoothed_poses(ultrasound.stream("tracker", "probe"), event_s[here])
    breath_valid = None
    if recording.breathing is not None:
        breathing = recording.breathing.part(here)
        breath_valid = breathing.known_breath if every_breath else breathing.usable
        if recording.tested is not None:
            chart = PoseChart(recording.tested, recording.heart.center_mm)
            rotations, translations = moved_to_rest(rotations, translations, breathing.xi_mm, chart)
    by_s = until_s if known_s is None else known_s
    images, mm = recording.images, recording.calibrations.probe_from_image.scale_mm_per_px
    information = frame_information(
        images[here],
        sector_of(recording.fan, images[here]),
        (float(mm[1]), float(mm[0])),
        before=images[first - 1] if first else None,
    )
    peaks_s = np.array([p.t_s for p in recording.peaks if p.detected_at_s <= by_s])
    beat = beat_phase(peaks_s, event_s[here])
    model_phase = retimed(recording.heart.model, beat.phi, beat.rr_s, recording.retiming)
    gated = gate_frames(
        model_phase,
        recording.heart.channels.fractions,
        image_valid=ultrasound.image_valid[here],
        pose_valid=tracked,
        beat_valid=beat.regular,
        information=information,
        breath_valid=breath_valid,
        window=window,
    )
    used = gated.index[subsample(len(gated.index), MAX_FRAMES)]
    number = recording.first_number + first
    return GatedFrames(first, number, gated, used, event_s[here], model_phase, rotations, translations)


def retimed(model: DvfModel, phi: FloatArray, rr_s: FloatArray, mode: RetimeMode) -> FloatArray:
    """Convert (n,) phases of the beat to the model's cycle, without a known RR as at the model's own rate."""
    finite_rr_s = np.where(np.isfinite(rr_s), rr_s, model.timing.rr_s)
    return retime(phi, finite_rr_s, model.timing.rr_s, model.es_fraction, mode=mode)


def ultrasound_mask(recording: UltrasoundRecording, frames: GatedFrames) -> BoolArray:
    """Find the (rows, columns) sector by the scanner's geometry, else by the used frames.

    Raises:
        InvalidInputError: the recording has no images.
    """
    return sector_of(recording.fan, recording.images[frames.first + frames.used])


def sector_of(fan: Fan | None, images: NDArray[np.uint8]) -> BoolArray:
    """Find the (rows, columns) sector by the scanner's geometry, else by these images."""
    if fan is not None:
        return fan_mask(fan, *images.shape[1:])
    return fan_mask_from_images(images)


@lru_cache(maxsize=4)
def fan_mask(fan: Fan, rows: int, columns: int) -> BoolArray:
    """Compute the mask of a fan, cached because every beat needs it."""
    mask = fan.mask(rows, columns)
    mask.setflags(write=False)
    return mask


def slices_of(
    recording: UltrasoundRecording, frames: GatedFrames, mask: BoolArray, *, pitch_mm: float
) -> SliceSet:
    """Prepare the used frames as slices in the tracker's frame."""
    used = frames.used
    tracked = TrackedImages(
        recording.images[frames.first + used],
        frames.rotations[used],
        frames.translations_mm[used],
        frames.model_phase[used],
        frames.event_s[used],
    )
    return prepare_slices(tracked, mask, recording.calibrations.probe_from_image, pitch_mm=pitch_mm)


# ------------------------------------------------------------------ probe motion


def smoothed_poses(stream: PoseStream, t_s: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Estimate rotations (k, 3, 3), translations (k, 3) and validity (k,) at the given times.

    Validity is that of `PoseStream.at_many`, and so is the pose where fewer than POSES valid samples lie
    around it without a gap.
    """
    rotations, translations, valid = stream.at_many(t_s)
    tracked = np.flatnonzero(stream.valid)
    chosen, window = _windows(stream.t_s[tracked], t_s)
    chosen &= valid
    if not chosen.any():
        return rotations, translations, valid
    near = tracked[window[chosen]]
    base = Rotation.from_matrix(np.repeat(rotations[chosen], POSES, axis=0))
    turns = (base.inv() * Rotation.from_matrix(stream.rotations[near].reshape(-1, 3, 3))).as_rotvec()
    shifts = stream.translations_mm[near] - translations[chosen, None]
    moved = np.concatenate([REACH_MM * turns.reshape(shifts.shape), shifts], axis=2)
    at_once, fits = _local_fits(stream.t_s[near] - t_s[chosen, None], moved)
    fitted = np.flatnonzero(chosen)[fits]
    step = at_once[fits]
    turned = Rotation.from_matrix(rotations[fitted]) * Rotation.from_rotvec(step[:, :3] / REACH_MM)
    rotations[fitted] = turned.as_matrix()
    translations[fitted] += step[:, 3:]
    return rotations, translations, valid


def _windows(known_s: FloatArray, t_s: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Find times with POSES samples around them without a gap, and (k, POSES) their indices."""
    count = len(known_s)
    if count < POSES:
        return np.zeros(len(t_s), dtype=np.bool_), np.zeros((len(t_s), POSES), dtype=np.int64)
    stretch = np.concatenate([[0], np.cumsum(np.diff(known_s) > MAX_GAP_S)])
    right = np.clip(np.searchsorted(known_s, t_s), 0, count - 1)
    first = np.searchsorted(stretch, stretch[right])
    last = np.searchsorted(stretch, stretch[right], side="right")
    begin = np.clip(right - POSES // 2, first, np.maximum(last - POSES, first))
    enough = last - first >= POSES
    return enough, np.where(enough, begin, 0)[:, None] + np.arange(POSES)


def _local_fits(x: FloatArray, y: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Fit polynomials to (k, n, 6) values at (k, n); return (k, 6) values at 0, and whether they fit."""
    reach = 1.1 * np.abs(x).max(axis=1, keepdims=True)
    powers = (x / reach)[:, :, None] ** np.arange(DEGREE + 1)
    near = ((1.0 - np.abs(x / reach) ** 3) ** 3)[:, :, None]
    weighted, plain = (np.swapaxes(powers, 1, 2) @ (w * powers) for w in (near, 1.0))
    at_once = np.linalg.solve(weighted, np.swapaxes(powers, 1, 2) @ (near * y))[:, 0]
    left = y - powers @ np.linalg.solve(plain, np.swapaxes(powers, 1, 2) @ y)
    residual = np.square(left).sum(axis=(1, 2)) / (6 * (POSES - DEGREE - 1))
    # the variance of white noise is 1/20 of that of its third differences; their median passes over a jump
    noise = np.median(np.square(np.diff(y, 3, axis=1)), axis=1).mean(axis=1) / 20.0 / MEDIAN_OF_SQUARES
    return at_once, residual <= MISFIT * noise
