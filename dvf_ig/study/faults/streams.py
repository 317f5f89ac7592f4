"""Streams of one clean intervention at a beating wall: ECG, tool and probe as stamped, and when each arrives.

The patient is a wall whose pose is known. In place of pixels the ultrasound has what images would say about
the pose, within noise; frames, their poses, their buffer and all decisions about registrations and beats
are the session's own. Left out are the registration of images and their comparison with the model, whose
false alarms `dvf-ig study watch` counts.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from heapq import merge
from operator import itemgetter

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth import EcgSpec, child_rng, synthetic_ecg
from data_synth.signals.rhythm import Beats, RhythmSpec, beat_series
from data_synth.signals.tracker import TrackerSpec, sampling_times, tracked
from dvf_ig.cardiac import RPeak
from dvf_ig.core import Grid, ImageMap, Points, Rigid, Stop, mean_displacement_mm
from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.registration import (
    Evidence,
    Gated,
    ImageStatistics,
    ModelChannels,
    PoseChart,
    RegistrationResult,
    ShapeEstimate,
)
from dvf_ig.registration.images import RegistrationOptions
from dvf_ig.registration.tracking.pose_estimate import BeatMeasurement, PoseEstimate
from dvf_ig.replay.events import pose_matrices
from dvf_ig.session import BeatEvaluation, GatedFrames, Heart, RegistrationRecord, RegistrationRequest
from dvf_ig.session.arrived_ultrasound import FrameBuffer
from dvf_ig.session.beat_evaluation import BEAT_COMPUTE_S, ComparedBeat, evaluation_of
from dvf_ig.session.events import EcgSamples, Event, ToolPose, TrackedFrame
from dvf_ig.session.gated_frames import MIN_FRAMES
from dvf_ig.session.setup import CalibrationsInUse, EcgSource, SessionSetup
from dvf_ig.session.work import Job, answered
from dvf_ig.study.passivity import wall_model

AMPLITUDE_MM = 5.0
MODEL_RR_S = 0.8
CENTER = np.zeros(3)
HOME = Rigid.from_rotation_vector([0.3, -0.5, 0.8], [60.0, -30.0, 12.0], "mr", "tracker")
"""mr_from_tracker of a patient at rest."""
TIP = Points("tool", np.array([[10.0, 0.0, 150.0]]))
LAG_S = -0.06
ECG_HZ = 250.0


@lru_cache(maxsize=1)
def wall_heart() -> Heart:
    """The wall, with channels that say when in the cycle it is known, and nothing else."""
    model = wall_model(AMPLITUDE_MM, rr_s=MODEL_RR_S)
    grid = Grid.axis_aligned("mr", (2, 2, 2), np.zeros(3), 1.0)
    channels = ModelChannels(grid, np.zeros((20, 2, 2, 2, 2), dtype=np.float32), np.arange(20) / 20)
    return Heart(model, channels, CENTER, None)


def wall_setup() -> SessionSetup:
    """A session that starts 3 mm from where the patient is."""
    probe_from_image = ImageMap(Rigid.identity("probe", "image"), np.array([4.0, 4.0]))
    calibrations = CalibrationsInUse(probe_from_image, LAG_S, TIP)
    start = pose_at(np.array([0.0, 0.0, 0.0, 3.0, 0.0, 0.0]))
    return SessionSetup(wall_heart(), calibrations, EcgSource(ECG_HZ), start=start)


def pose_at(coordinates: FloatArray) -> Rigid:
    """mr_from_tracker at (6,) coordinates about HOME, mm (`PoseChart`)."""
    return PoseChart(HOME, CENTER).pose(coordinates)


SIGMA_MM = 0.8
"""A beat tells each coordinate of the pose so well, as it says of itself."""
NOISE_MM = 0.25
"""Standard deviation of what it says, a coordinate."""
FEWEST_FRAMES = 4
"""Duration of a beat that can be compared."""

Coordinates = Callable[[float], FloatArray]
"""Time to the six coordinates of a pose about that at rest, mm."""


def at_rest(t_s: float) -> FloatArray:
    """The patient does not move."""
    return np.zeros(6)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class KnownBeat:
    """A beat whose ultrasound shows where the patient was half-way through it."""

    begin_s: float
    end_s: float
    detected_s: float
    pose: Rigid
    view_mm: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))

    def correct(self, shape: ShapeEstimate, pose: Rigid) -> tuple[None, float]:
        """Show no boundary: there are no images."""
        return None, 0.0

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
            view_mm=self.view_mm,
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
        return answered(request.record(frames, known_registration(pose_at(there), CENTER)))

    def beat(
        self, peaks: tuple[RPeak, ...], known_s: float, tested: PoseEstimate | None, *, in_use: bool
    ) -> Job[ComparedBeat]:
        """Where the patient was half-way through the beat."""
        begin, end = peaks[-2:]
        if len(self._shown_s(begin.t_s, end.t_s, known_s)) < FEWEST_FRAMES:
            return answered(ComparedBeat(None, None, irregular=False))
        there = pose_at(self._patient(0.5 * (begin.t_s + end.t_s)) + self._noise())
        beat = KnownBeat(begin.t_s, end.t_s, end.detected_at_s, there)
        compared = None if tested is None else evaluation_of(beat, tested, in_use=in_use)
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


def known_registration(pose: Rigid, center_mm: FloatArray) -> RegistrationResult:
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
        center_mm=center_mm,
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


TOOL_HZ, FRAME_HZ = 100.0, 12.0
TOOL_LATE_S, FRAME_LATE_S, ECG_LATE_S = 0.003, 0.030, 0.004
"""Least time from a stamp to the arrival; of the ECG, from a packet's last sample."""
ARRIVAL_JITTER_S = 0.0005
"""Mean of what comes on top of it, exponential."""
TOOL_TRACKER = TrackerSpec(rate_hz=TOOL_HZ, position_mm=0.1, rotation_deg=0.05)
PROBE_TRACKER = TrackerSpec(rate_hz=FRAME_HZ)
DEPTH_MM = 9.0
"""Range of the tip in the model, along the normal of the wall, which moves from 0 to 5 mm."""
CIRCLE_MM, CIRCLE_RAD_S = 10.0, 3.0
"""The tip moves along the wall at 30 mm/s."""

Arrival = tuple[float, Event]
"""When an event arrives, and the event."""
Arrivals = list[Arrival]
TipPath = Callable[[FloatArray], FloatArray]
"""Times (n,) to the tip (n, 3) in the model, mm."""


@read_only_arrays
@dataclass(frozen=True, slots=True)
class InterventionSpec:
    """Recorded intervention.

    Attributes:
        seconds: length.
        rhythm: of the heart.
        ecg_packet: samples of the ECG that arrive together; 5 are 20 ms.
        tip: where the tip moves.
        drift_ppm: by how much the clocks of tool, probe and ECG are fast.
    """

    seconds: float
    rhythm: RhythmSpec = field(default_factory=RhythmSpec)
    ecg_packet: int = 5
    tip: TipPath | None = None
    drift_ppm: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class Streams:
    """Arrivals of one intervention; faults change the lists."""

    tool: Arrivals
    frames: Arrivals
    ecg: Arrivals

    def merged(self) -> Arrivals:
        """In order of arrival."""
        return list(merge(self.tool, self.frames, self.ecg, key=itemgetter(0)))


def circling(t_s: FloatArray) -> FloatArray:
    """Inside the wall, at a steady speed along it."""
    turn = CIRCLE_RAD_S * t_s
    return np.stack([np.full(len(t_s), DEPTH_MM), CIRCLE_MM * np.cos(turn), CIRCLE_MM * np.sin(turn)], axis=1)


def drawn_beats(spec: InterventionSpec, seed: int) -> Beats:
    """When the heart beats."""
    return beat_series(spec.rhythm, 0.0, spec.seconds + 2.0, child_rng(seed, "rhythm"))


def drawn_ecg(spec: InterventionSpec, beats: Beats, seed: int) -> FloatArray:
    """(n, leads) mV from time 0 on."""
    return synthetic_ecg(beats, spec.seconds, EcgSpec(rate_hz=ECG_HZ), child_rng(seed, "ecg")).samples


def drawn_streams(spec: InterventionSpec, samples: FloatArray, seed: int) -> Streams:
    """The streams, with ECG `samples` (n, leads)."""
    tool_ppm, frame_ppm, ecg_ppm = (1e-6 * ppm for ppm in spec.drift_ppm)
    return Streams(
        _tool(spec, tool_ppm, child_rng(seed, "tool")),
        _frames(spec, frame_ppm, child_rng(seed, "probe")),
        _ecg(samples, spec.ecg_packet, child_rng(seed, "link"), ecg_ppm),
    )


def _ecg(samples: FloatArray, packet: int, rng: np.random.Generator, fast: float) -> Arrivals:
    first = np.arange(0, len(samples), packet)
    arrived = (first + packet - 1) / ECG_HZ + _late(ECG_LATE_S, len(first), rng)
    starts = (1.0 + fast) * first / ECG_HZ
    return [
        (arrived_s, EcgSamples(start_s, samples[k : k + packet]))
        for k, start_s, arrived_s in zip(first.tolist(), starts.tolist(), _in_order(arrived), strict=True)
    ]


def _tool(spec: InterventionSpec, fast: float, rng: np.random.Generator) -> Arrivals:
    tip = spec.tip or circling
    turn = Rotation.from_rotvec([0.2, 0.4, -0.1]).as_matrix()
    tracker_from_mr = HOME.inverse()

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        at = tracker_from_mr.apply_array(tip(t_s)) - turn @ TIP.xyz_mm[0]
        return np.broadcast_to(turn, (len(t_s), 3, 3)), at

    true_s, stamp_s = sampling_times(TOOL_TRACKER, 0.0, spec.seconds, rng)
    stream = tracked(path, "tracker", "tool", true_s, stamp_s, TOOL_TRACKER, rng)
    arrived = _in_order(stamp_s + _late(TOOL_LATE_S, len(stamp_s), rng))
    stamps = ((1.0 + fast) * stamp_s).tolist()
    return [
        (arrived_s, ToolPose(t_s, matrix))
        for arrived_s, t_s, matrix in zip(arrived, stamps, pose_matrices(stream), strict=True)
    ]


def _frames(spec: InterventionSpec, fast: float, rng: np.random.Generator) -> Arrivals:
    """A probe that is swept; images of one pixel, which says nothing."""
    pixel = np.ones((1, 1), dtype=np.uint8)
    pixel.setflags(write=False)

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        angle = np.zeros((len(t_s), 3))
        angle[:, 1] = 0.2 * np.sin(t_s)
        at = np.stack([np.zeros(len(t_s)), 10.0 * np.sin(0.3 * t_s), np.full(len(t_s), 80.0)], axis=1)
        return Rotation.from_rotvec(angle).as_matrix(), at

    true_s, stamp_s = sampling_times(PROBE_TRACKER, 0.0, spec.seconds, rng)
    stream = tracked(path, "tracker", "probe", true_s, stamp_s, PROBE_TRACKER, rng)
    arrived = _in_order(stamp_s + _late(FRAME_LATE_S, len(stamp_s), rng))
    stamps = ((1.0 + fast) * stamp_s).tolist()
    return [
        (arrived_s, TrackedFrame(t_s, pixel, matrix))
        for arrived_s, t_s, matrix in zip(arrived, stamps, pose_matrices(stream), strict=True)
    ]


def _late(least_s: float, n: int, rng: np.random.Generator) -> FloatArray:
    return least_s + rng.exponential(ARRIVAL_JITTER_S, n)


def _in_order(arrived_s: FloatArray) -> list[float]:
    """A link delivers in the order in which it was given."""
    ordered: list[float] = np.maximum.accumulate(arrived_s).tolist()
    return ordered
