"""One heart beat's ultrasound, asked about a pose as soon as the beat is over.

A beat is over when its second R peak has been detected, some 0.12 s after it. Its slices are prepared once,
at the one pitch of TRACK_PITCH_MM, and may be asked about more than one pose.
"""

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from dvf_ig.cardiac import RPeak
from dvf_ig.core import FloatArray, ImageMap, Rigid, Scenario
from dvf_ig.registration import BeatMeasurement, Lc2, SliceThreads, measure_beat

from .gated_frames import EVEN_MM, look, slices_at, ultrasound_mask
from .heart import Heart

TRACK_PITCH_MM = 2.0
PATCH_MM = 13.0
BEAT_COMPUTE_S = 0.15
"""What a beat tells is in force this long after its R peak was detected: an allowance for computing it."""
BEAT_WINDOW = 0.025
"""Half the distance between twenty phases of a model: every frame is compared with the nearest."""
FEWEST_SLICES = 4
LEAST_OVERLAP = 0.35
REMEMBERED_PEAKS = 12
"""R peaks that place a beat and tell whether it is regular."""


@dataclass(frozen=True, slots=True, eq=False)
class Beat:
    """A finished beat that was asked about a pose.

    Attributes:
        begin_s, end_s: its R peaks.
        detected_s: when the second was detected; decided_s: when the answer is in force.
        frames: slices that were compared.
        look: the answer about the pose then on trial.
        guided: that pose was guiding.
        seconds: computing time, preparation included.
    """

    begin_s: float
    end_s: float
    detected_s: float
    decided_s: float
    frames: int
    look: BeatMeasurement
    guided: bool
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class BeatSlices:
    """A beat's slices, ready to be asked; `seconds` is what their preparation took.

    A beat that does not steer only watches: it can put a pose in doubt, and not move it.
    """

    begin_s: float
    end_s: float
    detected_s: float
    metric: Lc2
    steers: bool
    frames: int
    seconds: float

    def asked(self, pose: Rigid, center_mm: FloatArray, guided: bool) -> Beat | None:
        """The answer about a pose; None where the slices hardly meet the model."""
        began = perf_counter()
        seen = measure_beat(self.metric, pose, center_mm)
        if seen.overlap < LEAST_OVERLAP:
            return None
        if not self.steers:
            seen = replace(seen, offset_information_mm=np.zeros(6), information=np.zeros((6, 6)))
        seconds = self.seconds + perf_counter() - began
        return Beat(
            self.begin_s,
            self.end_s,
            self.detected_s,
            self.detected_s + BEAT_COMPUTE_S,
            self.frames,
            seen,
            guided,
            seconds,
        )


def beat_slices(
    scenario: Scenario,
    heart: Heart,
    peaks: tuple[RPeak, ...],
    last: int,
    lag_s: float,
    probe_from_image: ImageMap,
    threads: SliceThreads,
) -> BeatSlices | None:
    """Slices of the beat that peak `last` ended; None where it is irregular or has too few frames.

    Args:
        threads: of the caller, for as long as the beat may be asked.
    """
    began = perf_counter()
    sight = look(
        scenario,
        heart,
        peaks[max(0, last + 1 - REMEMBERED_PEAKS) : last + 1],
        lag_s,
        from_s=peaks[last - 1].t_s,
        until_s=peaks[last].t_s,
        known_s=peaks[last].detected_at_s,
        window=BEAT_WINDOW,
    )
    if len(sight.used) < FEWEST_SLICES:
        return None
    mask = ultrasound_mask(scenario, sight.first + sight.used)
    slices = slices_at(scenario, heart, mask, probe_from_image, sight, pitch_mm=TRACK_PITCH_MM)
    metric = Lc2(
        slices,
        heart.fine,
        patch_mm=PATCH_MM,
        pitch_mm=TRACK_PITCH_MM,
        density_width_mm=EVEN_MM,
        threads=threads,
    )
    return BeatSlices(
        peaks[last - 1].t_s,
        peaks[last].t_s,
        peaks[last].detected_at_s,
        metric,
        heart.beats_steer,
        len(slices),
        perf_counter() - began,
    )
