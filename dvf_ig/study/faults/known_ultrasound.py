"""Ultrasound that is told where the patient is, in place of pixels: what the images would say, within noise.

Frames, their poses, their buffer and everything that is decided from registrations and beats are the
session's own. What is left out is the registration of images and their comparison with the model; their
false alarms are the matter of `dvf-ig study watch`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.cardiac import RPeak
from dvf_ig.core import FloatArray, Rigid, Stop, mean_displacement_mm
from dvf_ig.registration import (
    BeatMeasurement,
    Evidence,
    Gated,
    ImageStatistics,
    PoseChart,
    RegistrationOptions,
    RegistrationResult,
)
from dvf_ig.session import BeatEvaluation, GatedFrames, RegistrationRecord, RegistrationRequest
from dvf_ig.session.executor import Job, answered
from dvf_ig.session.ultrasound.beat_evaluation import BEAT_COMPUTE_S, ComparedBeat
from dvf_ig.session.ultrasound.frame_buffer import FrameBuffer
from dvf_ig.session.ultrasound.gated_frames import MIN_FRAMES

from .patient import CENTER, LAG_S, pose_at

SIGMA_MM = 0.8
"""A beat tells each coordinate of the pose so well, as it says of itself."""
NOISE_MM = 0.25
"""Standard deviation of what it says, a coordinate."""
FEWEST_FRAMES = 4
"""Of a beat that can be compared."""

Coordinates = Callable[[float], FloatArray]
"""Time to the six coordinates of a pose about that at rest, mm."""


def at_rest(t_s: float) -> FloatArray:
    """The patient does not move."""
    return np.zeros(6)


@dataclass(frozen=True, slots=True)
class KnownBeat:
    """A beat whose ultrasound shows where the patient was half-way through it."""

    begin_s: float
    end_s: float
    detected_s: float
    pose: Rigid

    def evaluate_beat(self, pose: Rigid, center_mm: FloatArray, *, in_use: bool) -> BeatEvaluation:
        """Compare the beat with a pose."""
        information = np.eye(6) / SIGMA_MM**2
        offset = PoseChart(pose, center_mm).coordinates(self.pose)
        measurement = BeatMeasurement(
            pose=pose,
            best=self.pose,
            offset_information_mm=information @ offset,
            information=information,
            similarity=0.4,
            best_similarity=0.6,
            log_likelihood_ratio=float(0.5 * offset @ information @ offset),
            wrong_pose_log_ratio=12.0,
            moved_mm=mean_displacement_mm(pose, self.pose, center_mm),
            overlap=1.0,
            evaluations=1,
        )
        return BeatEvaluation(
            begin_s=self.begin_s,
            end_s=self.end_s,
            detected_s=self.detected_s,
            decided_s=self.detected_s + BEAT_COMPUTE_S,
            frames=10,
            measurement=measurement,
            in_use=in_use,
            seconds=0.0,
            view_mm=np.zeros((3, 3)),
        )


class KnownUltrasound:
    """An `UltrasoundSource` on the frames that have arrived.

    Args:
        buffer: of the session.
        patient: where the patient is.
        rng: of what beats say.
        registered: where registrations are off to, by the time at which they are asked for.
    """

    def __init__(
        self,
        buffer: FrameBuffer,
        patient: Coordinates,
        rng: np.random.Generator,
        registered: Coordinates = at_rest,
    ) -> None:
        self._buffer, self._patient, self._rng = buffer, patient, rng
        self._registered = registered

    def register(self, request: RegistrationRequest, known_s: float) -> Job[RegistrationRecord]:
        """Where the patient was on average over the frames."""
        event_s = self._shown_s(request.from_s, request.until_s, known_s)
        if not len(event_s):
            return answered(request.record(None, failure="no ultrasound image has arrived"))
        n, index = len(event_s), np.arange(len(event_s), dtype=np.int64)
        turns = np.tile(np.eye(3), (n, 1, 1))
        frames = GatedFrames(0, 0, Gated(index, {}), index, event_s, np.zeros(n), turns, np.zeros((n, 3)))
        if n < MIN_FRAMES:
            return answered(request.record(frames))
        mean = np.mean([self._patient(t_s) for t_s in event_s.tolist()], axis=0)
        there = mean + self._registered(request.until_s) + self._noise()
        return answered(request.record(frames, _registration(pose_at(there))))

    def beat(
        self, peaks: tuple[RPeak, ...], known_s: float, pose: Rigid | None, *, in_use: bool
    ) -> Job[ComparedBeat]:
        """Where the patient was half-way through the beat."""
        begin, end = peaks[-2:]
        if len(self._shown_s(begin.t_s, end.t_s, known_s)) < FEWEST_FRAMES:
            return answered(ComparedBeat(None, None, irregular=False))
        there = pose_at(self._patient(0.5 * (begin.t_s + end.t_s)) + self._noise())
        beat = KnownBeat(begin.t_s, end.t_s, end.detected_at_s, there)
        compared = None if pose is None else beat.evaluate_beat(pose, CENTER, in_use=in_use)
        return answered(ComparedBeat(beat, compared, irregular=False))

    def _noise(self) -> FloatArray:
        return NOISE_MM * self._rng.standard_normal(6)

    def _shown_s(self, from_s: float, until_s: float, known_s: float) -> FloatArray:
        """Event times of tracked frames with an image."""
        part = self._buffer.between(from_s - max(0.0, LAG_S), known_s)
        if part is None:
            return np.zeros(0)
        sequence, _ = part
        event_s = sequence.t_s + LAG_S
        shown = sequence.image_valid & sequence.stream("tracker", "probe").valid
        return np.asarray(event_s[shown & (event_s >= from_s) & (event_s < until_s)])


def _registration(pose: Rigid) -> RegistrationResult:
    """A registration that ended at `pose` and found nothing against itself."""
    covariance = np.diag([(0.4 / 40) ** 2] * 3 + [0.4**2] * 3)
    return RegistrationResult(
        target_from_source=pose,
        start=pose,
        stop=Stop.CONVERGED,
        success_probability=1.0,
        tre_bound_mm=2.0,
        covariance=covariance,
        noise_covariance=covariance,
        center_mm=CENTER,
        similarity=0.6,
        start_similarity=0.5,
        overlap=1.0,
        evidence=Evidence(z_score=10.0, split_half_mm=0.2, phase_mm=0.5),
        statistics=ImageStatistics(0.3, 0.8, 0.8, 0.9, 48.0, 30.0, 25.0, 0.6, 1.0, 300.0),
        outside="",
        second_best=0.0,
        moved_mm=1.0,
        evaluations=1,
        seconds=1.0,
        slices=48,
        options=RegistrationOptions(),
    )
