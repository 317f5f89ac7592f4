"""The ultrasound of one heart beat, compared with a pose as soon as the beat is over.

A beat is over when its second R peak has been detected, some 0.12 s after it. Its slices are prepared once,
at the one pitch of BEAT_PITCH_MM, and may be compared with more than one pose.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.registration import (
    DENSITY_WIDTH_MM,
    BeatMeasurement,
    CoveredPart,
    FrameRejection,
    Lc2,
    PoseEstimate,
    ShapeEstimate,
    SliceSet,
    SliceThreads,
    boundary_points,
    measure_beat,
)

from .breathing_motion import FrameBreathing
from .gated_frames import UltrasoundRecording, gate_recording, slices_of, ultrasound_mask

BEAT_PITCH_MM = 2.0
"""Pixels of a beat's slices."""
PATCH_MM = 13.0
"""Edge of an LC2 patch."""
BEAT_COMPUTE_S = 0.15
"""A beat's evaluation takes effect this long after its R peak was detected: an allowance for computing it."""
BEAT_WINDOW = 0.025
"""Half the distance between twenty phases of a model: every frame is compared with the nearest."""
MIN_SLICES = 4
"""Fewest slices that are evidence of the pose."""
MIN_OVERLAP = 0.35
"""Least share of the slices inside the model's volume."""
GATING_PEAKS = 12
"""R peaks that place a beat and decide whether it is regular."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatEvaluation:
    """A finished beat that was compared with a pose.

    Attributes:
        begin_s, end_s: its R peaks.
        detected_s: when the second was detected; decided_s: when the evaluation takes effect.
        frames: slices that were compared.
        measurement: the optimum of the beat, and how much better it matches there.
        in_use: the pose was in use, not waiting to be confirmed.
        seconds: computing time, preparation included.
        view_mm: (3, 3) three points of the mean plane of its slices, frame "tracker".
        shape: the change of shape of the estimate it was compared with, corrected by its boundary; None if
            that follows none.
    """

    begin_s: float
    end_s: float
    detected_s: float
    decided_s: float
    frames: int
    measurement: BeatMeasurement
    in_use: bool
    seconds: float
    view_mm: FloatArray
    shape: ShapeEstimate | None = None


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatSlices:
    """A beat's slices, ready to be compared with poses.

    Attributes:
        begin_s, end_s, detected_s, frames: as in `BeatEvaluation`.
        view_mm: as in `BeatEvaluation`.
        metric_at: their similarity to what is known of the heart, chosen at a pose.
        updates_pose: whether the beat may move the pose in use; otherwise it can only suspend it.
        seconds: computing time of the preparation.
        clock: seconds of computing time, from any origin.
        numbers: indices of the slices' frames in the recording.
        slices: those that are compared.
    """

    begin_s: float
    end_s: float
    detected_s: float
    frames: int
    view_mm: FloatArray
    metric_at: Callable[[Rigid], Lc2]
    updates_pose: bool
    seconds: float
    clock: Callable[[], float]
    numbers: IntArray
    slices: SliceSet

    def correct(self, shape: ShapeEstimate, pose: Rigid) -> tuple[ShapeEstimate, float]:
        """Correct a change of shape by the boundary that the beat shows; with it the computing time, s."""
        began = self.clock()
        return shape.predicted(1.0).corrected(boundary_points(self.slices), pose), self.clock() - began

    def measure(self, pose: Rigid, center_mm: FloatArray) -> BeatMeasurement | None:
        """Measure the beat at a pose; None if the slices hardly overlap the model."""
        metric = self.metric_at(pose)
        if metric.information <= 0.0:
            return None
        measurement = measure_beat(metric, pose, center_mm)
        return None if measurement.overlap < MIN_OVERLAP else measurement

    def evaluate_beat(self, pose: Rigid, center_mm: FloatArray, *, in_use: bool) -> BeatEvaluation | None:
        """Compare the beat with a pose; None if the slices hardly overlap the model."""
        began = self.clock()
        measurement = self.measure(pose, center_mm)
        if measurement is None:
            return None
        if not self.updates_pose:
            measurement = replace(
                measurement, offset_information_mm=np.zeros(6), information=np.zeros((6, 6))
            )
        return BeatEvaluation(
            begin_s=self.begin_s,
            end_s=self.end_s,
            detected_s=self.detected_s,
            decided_s=self.detected_s + BEAT_COMPUTE_S,
            frames=self.frames,
            measurement=measurement,
            in_use=in_use,
            seconds=self.seconds + self.clock() - began,
            view_mm=self.view_mm,
        )


def evaluation_of(beat: "ComparableBeat", tested: PoseEstimate, *, in_use: bool) -> BeatEvaluation | None:
    """Compare a beat with an estimate, where its images should match, and state it of the estimate's pose."""
    pose, variance_mm2 = tested.matched_in(beat.view_mm)
    evaluation = beat.evaluate_beat(pose, tested.center_mm, in_use=in_use)
    if evaluation is None:
        return None
    evaluation = replace(evaluation, measurement=evaluation.measurement.of(tested, variance_mm2))
    if tested.shape is None:
        return evaluation
    shape, seconds = beat.correct(tested.shape, tested.pose)
    return replace(evaluation, shape=shape, seconds=evaluation.seconds + seconds)


@dataclass(frozen=True, slots=True, eq=False)
class BreathEvaluation:
    """The frames of a whole beat, wherever in the breath, compared with a pose of the heart at rest."""

    measurement: BeatMeasurement
    frames: FrameBreathing


@dataclass(frozen=True, slots=True, eq=False)
class ComparedBeat:
    """Outcome of a finished beat.

    Attributes:
        slices: None if the beat cannot be compared with the model.
        evaluation: of the pose it was compared with; None without one, or if they hardly overlap.
        irregular: the beat came early or late, so that its phase is not known, or its frames show the heart
            in a part of the breath that is not understood.
        breathing: what it tells of the motion in breathing; None if nothing follows the breath.
    """

    slices: "ComparableBeat | None"
    evaluation: BeatEvaluation | None
    irregular: bool
    breathing: "BreathEvaluation | None" = None


class ComparableBeat(Protocol):
    """The ultrasound of one beat, see `BeatSlices`."""

    @property
    def begin_s(self) -> float: ...

    @property
    def end_s(self) -> float: ...

    @property
    def view_mm(self) -> FloatArray: ...

    def evaluate_beat(self, pose: Rigid, center_mm: FloatArray, *, in_use: bool) -> BeatEvaluation | None:
        """Compare the beat with a pose; None if they hardly overlap."""
        ...

    def correct(self, shape: ShapeEstimate, pose: Rigid) -> tuple[ShapeEstimate | None, float]:
        """Correct a change of shape at a pose, None without images; with it the computing time, s."""
        ...


def compare_beat(
    recording: UltrasoundRecording,
    tested: PoseEstimate | None,
    clock: Callable[[], float],
    threads: SliceThreads,
    *,
    in_use: bool,
) -> ComparedBeat:
    """Compare the beat that the last R peak ended with an estimate, unless that is None."""
    beat, irregular = _prepared(recording, clock, threads)
    evaluation = None
    if beat is not None and tested is not None:
        evaluation = evaluation_of(beat, tested, in_use=in_use)
    in_breathing = None
    if recording.breathing is not None and tested is not None:
        if evaluation is not None and beat is not None and recording.breathing.learnt:
            in_breathing = BreathEvaluation(evaluation.measurement, recording.breathing.part(beat.numbers))
        else:
            in_breathing = _in_breathing(recording, tested, clock, threads)
    return ComparedBeat(beat, evaluation, irregular, in_breathing)


def _in_breathing(
    recording: UltrasoundRecording, tested: PoseEstimate, clock: Callable[[], float], threads: SliceThreads
) -> BreathEvaluation | None:
    """Compare all frames of the beat with an estimate; None if they are too few, or hardly overlap."""
    if recording.breathing is None:
        return None
    beat, _ = _prepared(recording, clock, threads, every_breath=True)
    if beat is None:
        return None
    pose, variance_mm2 = tested.matched_in(beat.view_mm)
    measurement = beat.measure(pose, tested.center_mm)
    if measurement is None:
        return None
    return BreathEvaluation(measurement.of(tested, variance_mm2), recording.breathing.part(beat.numbers))


def _prepared(
    recording: UltrasoundRecording,
    clock: Callable[[], float],
    threads: SliceThreads,
    *,
    every_breath: bool = False,
) -> tuple[BeatSlices | None, bool]:
    """Prepare the slices of the beat that the last R peak ended; None, and whether it was irregular."""
    began, (begin, end) = clock(), recording.peaks[-2:]
    frames = gate_recording(
        replace(recording, peaks=recording.peaks[-GATING_PEAKS:]),
        from_s=begin.t_s,
        until_s=end.t_s,
        known_s=end.detected_at_s,
        window=BEAT_WINDOW,
        every_breath=every_breath,
    )
    if len(frames.used) < MIN_SLICES:
        irregular = frames.gated.rejected[FrameRejection.IRREGULAR_BEAT] > 0
        if recording.breathing is not None:
            here = slice(frames.first, frames.first + len(frames.event_s))
            irregular |= not recording.breathing.usable[here].all()
        return None, irregular
    slices = slices_of(recording, frames, ultrasound_mask(recording, frames), pitch_mm=BEAT_PITCH_MM)
    metric = partial(
        Lc2,
        model=recording.heart.channels,
        patch_mm=PATCH_MM,
        pitch_mm=BEAT_PITCH_MM,
        density_width_mm=DENSITY_WIDTH_MM,
        threads=threads,
    )
    beat = BeatSlices(
        begin_s=begin.t_s,
        end_s=end.t_s,
        detected_s=end.detected_at_s,
        frames=len(slices),
        view_mm=_view_mm(slices),
        metric_at=_metric_at(metric, slices, recording.heart.covered),
        updates_pose=recording.heart.beats_update_pose,
        seconds=clock() - began,
        clock=clock,
        numbers=frames.first + frames.used,
        slices=slices,
    )
    return beat, False


def _metric_at(
    metric: Callable[[SliceSet], Lc2], slices: SliceSet, covered: CoveredPart | None
) -> Callable[[Rigid], Lc2]:
    """Compare all pixels, or at each pose those of the part of the heart that its images cover."""
    if covered is not None:
        return lambda pose: metric(covered.compared(slices, pose))
    whole = metric(slices)
    return lambda _: whole


def _view_mm(slices: SliceSet) -> FloatArray:
    """Return (3, 3) two points half-way down the mean plane and one near its lower edge."""
    rows, columns = slices.images.shape[1:]
    pixels = np.array(
        [
            [0.25 * columns, 0.5 * rows, 1.0],
            [0.75 * columns, 0.5 * rows, 1.0],
            [0.5 * columns, 0.9 * rows, 1.0],
        ]
    )
    return np.asarray(pixels @ slices.frame_from_pixel.mean(axis=0).T)
