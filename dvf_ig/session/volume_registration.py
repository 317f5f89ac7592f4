"""Registration of gated 3-D ultrasound to the model: which volume belongs to which of its phases."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dvf_ig.cardiac import RPeak, beat_phase
from dvf_ig.core import (
    DvfModel,
    FloatArray,
    InvalidInputError,
    NoOverlapError,
    Rigid,
    TrackedVolume,
    VolumeSeries,
    phase_distance,
)
from dvf_ig.registration import (
    PHASE_WINDOW,
    VOLUME_SMOOTHING_MM,
    LandmarkPrior,
    RegistrationResult,
    channels_from_mr,
    images_of_volumes,
    register,
)

from .heart import Heart
from .ultrasound.gated_frames import retimed

_LOG = logging.getLogger(__name__)
OVERLAP_STEP = 6
"""Every sixth voxel along each axis is tested for overlap."""


def model_phase_at(model: DvfModel, peaks: Sequence[RPeak], t_s: float) -> float:
    """Where in the model's cycle an image of that moment belongs, from the R peaks around it.

    Systole is retimed as for tracked frames ("two-segment", see `cardiac.retime`).

    Args:
        peaks: in time order.
        t_s: on the clock of the ECG.
    Raises:
        InvalidInputError: no R peak before or after it, or an irregular beat.
    """
    known = np.array([peak.t_s for peak in peaks])
    beat = beat_phase(known, np.array([t_s]))
    if not np.isfinite(beat.rr_s[0]):
        span = f"{known[0]:.2f} to {known[-1]:.2f} s" if len(known) else "none"
        raise InvalidInputError(
            f"an ultrasound volume of {t_s:g} s lies in no heart beat of the ECG (R peaks: {span}); both "
            "must be on one clock"
        )
    if not beat.regular[0]:
        raise InvalidInputError(
            f"an ultrasound volume of {t_s:g} s was taken in or after an irregular beat, whose place in the "
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
    prior: LandmarkPrior | None = None,
    landmarks: Rigid | None = None,
) -> RegistrationResult:
    """Register gated volumes to the model's phases nearest to theirs.

    Args:
        heart: what `build_heart` made, of `mr` if that is known.
        start: mr_from_tracker to begin at.
        mr: the 4-D grey levels; None if the model alone is known.
        seed: of the displaced starts.
        clock: seconds from any origin, for the result's `seconds`.
        prior, landmarks: see `registration.register`.
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
        prior=prior,
        landmarks=landmarks,
    )


def _as_volumes_see(heart: Heart, volumes: Sequence[TrackedVolume], mr: VolumeSeries | None) -> Heart:
    """The heart with MR smoothed as volumes need it, at the phases in use alone."""
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
    """Raise NoOverlapError where no insonified voxel lies within the model's image at the start."""
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
