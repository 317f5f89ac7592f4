"""ECG-gated registration on the ultrasound that has arrived by some moment."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from dvf_ig.cardiac import RPeak, beat_phase, retime
from dvf_ig.core import (
    BoolArray,
    DvfModel,
    FloatArray,
    ImageMap,
    IntArray,
    InvalidInputError,
    NoOverlapError,
    Rigid,
    Scenario,
    read_only_arrays,
)
from dvf_ig.registration import (
    PHASE_WINDOW,
    Boundary,
    Gated,
    LandmarkPrior,
    Level,
    RegistrationData,
    RegistrationOptions,
    RegistrationResult,
    SliceSet,
    boundary_points,
    fan_mask_from_images,
    gate_frames,
    prepare_slices,
    prior_from_landmarks,
    register_rigid,
    root_amplitude,
    start_from_landmarks,
    subsample,
)

from .heart import COARSE_PITCH_MM, FINE_PITCH_MM, Heart

SLICES = 48
EVEN_MM = 12.0
"""Patches share their weight over this width: a sweep sees the heart's middle from everywhere. On tuning
seeds 101–104 it takes the TRE from 1.02 to 0.93 mm, the force error from 0.081 to 0.079 N; 20 mm do alike."""
MIN_SLICES = 16
STARTS = RegistrationOptions().starts


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """Ultrasound frames that can be compared with the model at one moment.

    Indices count from `first`, the first frame of the time that was looked at.

    Attributes:
        first: index in the recording of the first of the n frames in time.
        gated: which of them were kept and why others were not.
        used: (k,) the kept frames that registration looks at.
        event_s: (n,) event times on the tracker clock.
        model_phase: (n,) places in the model's cycle.
        rotations, translations_mm: (n, 3, 3), (n, 3) tracker_from_probe at the event times.
    """

    first: int
    gated: Gated
    used: IntArray
    event_s: FloatArray
    model_phase: FloatArray
    rotations: FloatArray
    translations_mm: FloatArray


def look(
    scenario: Scenario,
    heart: Heart,
    peaks: tuple[RPeak, ...],
    lag_s: float,
    *,
    from_s: float,
    until_s: float,
    known_s: float | None = None,
    window: float = PHASE_WINDOW,
) -> Sight:
    """Gate the frames whose event lies in [from_s, until_s).

    Args:
        known_s: R peaks that had been detected by then place them; `until_s` unless given.
        window: see `gate_frames`.
    """
    event_s = scenario.ultrasound.t_s + lag_s
    first, last = (int(i) for i in np.searchsorted(event_s, [from_s, until_s]))
    here = slice(first, last)
    rotations, translations, tracked = scenario.ultrasound.stream("tracker", "probe").at_many(event_s[here])
    known = np.array([p.t_s for p in peaks if p.detected_at_s <= (until_s if known_s is None else known_s)])
    beat = beat_phase(known, event_s[here])
    model_phase = retimed(heart.model, beat.phi, beat.rr_s)
    gated = gate_frames(
        model_phase,
        heart.fine.fractions,
        image_valid=scenario.ultrasound.image_valid[here],
        pose_valid=tracked,
        beat_valid=beat.regular,
        window=window,
    )
    used = gated.index[subsample(len(gated.index), SLICES)]
    return Sight(first, gated, used, event_s[here], model_phase, rotations, translations)


def retimed(model: DvfModel, phi: FloatArray, rr_s: FloatArray) -> FloatArray:
    """(n,) place in the model's cycle; moments without a known RR are placed as at the model's own rate."""
    known = np.where(np.isfinite(rr_s), rr_s, model.timing.rr_s)
    return retime(phi, known, model.timing.rr_s, model.es_fraction, mode="two-segment")


def start_pose(scenario: Scenario) -> Rigid:
    """The operator's coarse pose, else the landmark fit.

    Raises:
        InvalidInputError: the scenario holds neither.
    """
    if scenario.start is not None:
        return scenario.start
    touched = landmark_pose(scenario)
    if touched is not None:
        return touched
    raise InvalidInputError(
        "the scenario has neither a start pose nor landmarks; add start.tfm, or landmarks_mr.mrk.json and "
        "landmarks_tracker.mrk.json"
    )


def landmark_pose(scenario: Scenario) -> Rigid | None:
    """The landmark fit, where landmarks were touched."""
    if scenario.landmarks_mr is None or scenario.landmarks_tracker is None:
        return None
    return start_from_landmarks(scenario.landmarks_mr, scenario.landmarks_tracker).mr_from_tracker


def _prior(scenario: Scenario) -> LandmarkPrior | None:
    """Landmarks take part where the start came from them; a start pose takes their place."""
    if scenario.start is not None or scenario.landmarks_mr is None or scenario.landmarks_tracker is None:
        return None
    return prior_from_landmarks(scenario.landmarks_mr, scenario.landmarks_tracker)


def ultrasound_mask(scenario: Scenario, frames: IntArray) -> BoolArray:
    """(rows, columns) sector, from the scanner's geometry, else from what `frames` show.

    Raises:
        InvalidInputError: the recording has no images.
    """
    images = _images(scenario)
    if scenario.fan is not None:
        return scenario.fan.mask(*images.shape[1:])
    return fan_mask_from_images(images[frames])


def _images(scenario: Scenario) -> NDArray[np.uint8]:
    if scenario.ultrasound.images is None:
        raise InvalidInputError("the ultrasound recording has no images; registration needs them")
    return scenario.ultrasound.images


def slices_at(
    scenario: Scenario,
    heart: Heart,
    mask: BoolArray,
    probe_from_image: ImageMap,
    sight: Sight,
    *,
    pitch_mm: float,
) -> SliceSet:
    """The used frames of `sight` in the tracker's frame."""
    used = sight.used
    return prepare_slices(
        _images(scenario)[sight.first + used],
        mask,
        probe_from_image,
        sight.rotations[used],
        sight.translations_mm[used],
        sight.model_phase[used],
        sight.event_s[used],
        pitch_mm=pitch_mm,
        brightness=heart.brightness,
    )


def locate(
    scenario: Scenario,
    heart: Heart,
    sight: Sight,
    probe_from_image: ImageMap,
    start: Rigid,
    *,
    seed: int,
    warm: bool = False,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """Register the frames of `sight` to the model from `start`; `warm` trusts it and skips displaced starts.

    Raises:
        InvalidInputError: the recording has no images.
        NoOverlapError: too few frames passed the gate; says why.
    """
    if len(sight.used) < MIN_SLICES:
        reasons = ", ".join(f"{count} {reason}" for reason, count in sight.gated.rejected.items() if count)
        raise NoOverlapError(
            f"{len(sight.used)} ultrasound frames can be compared with the model ({reasons}); "
            f"needed at least {MIN_SLICES}: check probe tracking and ECG"
        )
    mask = ultrasound_mask(scenario, sight.first + sight.used)
    coarse, fine = (
        Level(slices_at(scenario, heart, mask, probe_from_image, sight, pitch_mm=pitch), channels, pitch)
        for pitch, channels in ((COARSE_PITCH_MM, heart.coarse), (FINE_PITCH_MM, heart.fine))
    )
    boundary = None
    if heart.surface is not None:
        shown = replace(heart, brightness=root_amplitude)
        borders = slices_at(scenario, shown, mask, probe_from_image, sight, pitch_mm=FINE_PITCH_MM)
        boundary = Boundary(boundary_points(borders), heart.surface)
    return register_rigid(
        RegistrationData(coarse, fine, heart.center_mm, boundary, _prior(scenario)),
        start,
        rng=np.random.default_rng(seed),
        clock=perf_counter,
        options=RegistrationOptions(
            starts=0 if warm else STARTS, density_width_mm=EVEN_MM, boundary_share=heart.boundary_share
        ),
        progress=progress,
    )
