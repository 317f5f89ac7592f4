"""A session on the beating ball: streams made here, and images of which one pixel says where the patient is.

Everything of the session is real except what is done with pixels: `register_known` and `compare_known` stand
in for the registration of frames and the comparison of a beat with the model.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from heapq import merge
from typing import Any

import numpy as np
from known_patient import Patient, known_beat, registration, still
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from toy_ball import CENTERS, ball_model

from dvf_ig.core import BoolArray, Fan, FloatArray, Grid, ImageMap, NoOverlapError, Points, Rigid
from dvf_ig.registration import ModelChannels, PoseChart, PoseEstimate, RegistrationResult
from dvf_ig.session import (
    CalibrationsInUse,
    EcgSamples,
    EcgSource,
    Event,
    GatedFrames,
    GuidanceState,
    Heart,
    Session,
    SessionSetup,
    ToolPose,
    TrackedFrame,
    UltrasoundRecording,
)
from dvf_ig.session.beat_evaluation import BreathEvaluation, ComparedBeat, evaluation_of
from dvf_ig.study.faults.streams import KnownBeat

RR_S, ECG_HZ, FRAME_HZ, TOOL_HZ, TICK_S = 0.8, 250.0, 20.0, 100.0, 0.01
LAG_S = -0.06
CENTER = CENTERS.mean(axis=0)
HOME = Rigid.from_rotation_vector([0.3, -0.5, 0.8], [60.0, -30.0, 12.0], "mr", "tracker")
GUIDED_S = 12.5
"""The first registration is asked for at 8 s and known at 11 s; three beats have confirmed it by then."""
IMAGE = (24, 24)
TIP = Points("tool", np.array([[10.0, 0.0, 150.0]]))
FEWEST = 4
"""Frames of a beat that can be compared."""


@lru_cache(maxsize=1)
def toy_heart() -> Heart:
    """The ball with channels that say when in the cycle it is known, and nothing else."""
    grid = Grid.axis_aligned("mr", (2, 2, 2), np.zeros(3), 1.0)
    channels = ModelChannels(grid, np.zeros((20, 2, 2, 2, 2), dtype=np.float32), np.arange(20) / 20)
    return Heart(ball_model(), channels, CENTER, None)


def toy_setup(*, start: Rigid | None = HOME) -> SessionSetup:
    probe_from_image = ImageMap(Rigid.identity("probe", "image"), np.array([4.0, 4.0]))
    calibrations = CalibrationsInUse(probe_from_image, LAG_S, TIP)
    everything = Fan(np.array([12.0, -40.0]), 1.0, 500.0, 1.5)
    return SessionSetup(toy_heart(), calibrations, EcgSource(ECG_HZ), start=start, fan=everything)


def pose_of(patient: Patient, t_s: float) -> Rigid:
    return PoseChart(HOME, CENTER).pose(patient(t_s))


# ------------------------------------------------------------------ streams


def ecg_of(from_s: float, until_s: float, *, leads: int = 1, r_peaks: FloatArray | None = None) -> FloatArray:
    """(n, leads) narrow complexes, steady unless their times are given."""
    t = np.arange(round(from_s * ECG_HZ), round(until_s * ECG_HZ)) / ECG_HZ
    peaks = np.arange(0.4, 1000.0, RR_S) if r_peaks is None else r_peaks
    away = np.abs(t[:, None] - peaks[(peaks > from_s - 1) & (peaks < until_s + 1)]).min(axis=1, initial=9.0)
    wave = np.exp(-0.5 * (away / 0.012) ** 2) + 0.005 * np.sin(997.0 * t * t)
    return np.tile(wave[:, None], (1, leads))


def ecg_events(samples: FloatArray, *, chunk: int = 50, from_s: float = 0.0) -> list[EcgSamples]:
    return [
        EcgSamples(from_s + first / ECG_HZ, samples[first : first + chunk])
        for first in range(0, len(samples), chunk)
    ]


ROW, COLUMN = np.mgrid[: IMAGE[0], : IMAGE[1]]
STRUCTURE: NDArray[np.uint8] = np.rint(
    120.0 + 60.0 * np.sin(2 * np.pi * ROW / 16) * np.cos(2 * np.pi * COLUMN / 16)
).astype(np.uint8)


def image_of(x_mm: float, number: int) -> NDArray[np.uint8]:
    """Structure over centimetres, the patient's shift along x in the first pixel, the frame in the next."""
    image = STRUCTURE.copy()
    image[0, 0], image[0, 1] = round(128 + 10 * x_mm), 1 + number % 250
    return image


def frame_events(until_s: float, *, patient: Patient = still) -> list[TrackedFrame]:
    """FRAME_HZ frames of a probe that is swept; what they show happened LAG_S after their stamp."""
    times = np.arange(round(until_s * FRAME_HZ)) / FRAME_HZ + 0.003
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(0.2 * np.sin(times), [0, 1, 0])).as_matrix()
    poses[:, 1, 3], poses[:, 2, 3] = times, 80.0
    return [
        TrackedFrame(t_s, image_of(patient(t_s + LAG_S)[3], number), pose)
        for number, (t_s, pose) in enumerate(zip(times.tolist(), poses, strict=True))
    ]


def tool_events(until_s: float, *, at: Callable[[float], FloatArray] | None = None) -> list[ToolPose]:
    """TOOL_HZ poses of a tool whose tip stays deep inside the ball, never quite at rest."""

    def inside(t_s: float) -> FloatArray:
        moved = np.array([0.3 * np.sin(3.0 * t_s), 6.0, 0.3 * np.cos(2.0 * t_s)])
        return np.asarray(CENTER + moved)

    times = (np.arange(round(until_s * TOOL_HZ)) / TOOL_HZ).tolist()
    tips_mr = np.array([(at or inside)(t_s) for t_s in times])
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, 3] = HOME.inverse().apply_array(tips_mr) - TIP.xyz_mm[0]
    return [ToolPose(t_s, pose) for t_s, pose in zip(times, poses, strict=True)]


def stamp(event: Event) -> float:
    return event.start_s if isinstance(event, EcgSamples) else event.t_s


@dataclass
class Streams:
    """What a session is pushed; tests change the lists."""

    ecg: list[EcgSamples]
    frames: list[TrackedFrame]
    tool: list[ToolPose]
    others: list[Event] = field(default_factory=list)

    def merged(self) -> list[Event]:
        """In order of their stamps."""
        return list(merge(self.ecg, self.frames, self.tool, self.others, key=stamp))


def toy_streams(until_s: float, *, patient: Patient = still, chunk: int = 50) -> Streams:
    """Streams of a steady heart; their events are made once, their lists are the caller's."""
    made = _made_streams(until_s, patient, chunk)
    return Streams(list(made.ecg), list(made.frames), list(made.tool))


@lru_cache(maxsize=8)
def _made_streams(until_s: float, patient: Patient, chunk: int) -> Streams:
    return Streams(
        ecg_events(ecg_of(0.0, until_s), chunk=chunk),
        frame_events(until_s, patient=patient),
        tool_events(until_s),
    )


# ------------------------------------------------------------------ running


def ticks(from_s: float, until_s: float, step_s: float = TICK_S) -> list[float]:
    return [round(from_s + k * step_s, 9) for k in range(round((until_s - from_s) / step_s))]


def run(session: Session, events: Iterable[Event], times: Sequence[float]) -> list[GuidanceState]:
    """States at `times`, each event pushed just before the first of them that is not before its stamp.

    Events need not be in the order of their stamps: an event keeps those behind it waiting.
    """
    waiting = list(events)
    states, pushed = [], 0
    for now_s in times:
        while pushed < len(waiting) and stamp(waiting[pushed]) <= now_s:
            session.push(waiting[pushed])
            pushed += 1
        states.append(session.state(now_s))
    return states


def guided(streams: Streams, until_s: float, *, from_s: float = GUIDED_S) -> list[GuidanceState]:
    """States of a new session from `from_s` on."""
    with Session(toy_setup()) as session:
        return run(session, streams.merged(), ticks(from_s, until_s))


def bits(state: GuidanceState) -> tuple[object, ...]:
    """All that a state says, to be compared bit by bit."""
    numbers = [
        state.now_s,
        state.pose_age_s,
        state.model_phase,
        state.distance_mm,
        state.distance_sigma_mm,
        state.rate_mm_per_cycle,
        state.tool.age_s,
        *state.phase,
        *(state.breath.state, state.breath.phase, state.breath.displacement_mm),
        *state.force_n,
        *state.wanted_n,
        *state.gradient,
        *state.tool.tip_tracker_mm,
        *state.transform.packed.view(np.float64),
    ]
    estimate, last = state.estimate, state.registration
    return (
        np.array(numbers).tobytes(),
        None if estimate is None else (estimate.pose.matrix.tobytes(), estimate.covariance_mm2.tobytes()),
        None if last is None else (last.asked_s, last.ready_s, last.reason),
        (state.status, state.supervisor, state.supervised.hazards, state.supervised.cause, state.conflict),
        state.reasons,
        state.rearmed,
    )


# ------------------------------------------------------------------ what is done with pixels


def register_known(
    recording: UltrasoundRecording, frames: GatedFrames, start: Rigid, **_: Any
) -> RegistrationResult:
    """In place of `register_frames`: the mean of what the frames say."""
    said = recording.images[frames.first + frames.used, 0, 0].astype(np.float64)
    if not said.all():
        raise NoOverlapError("the images are black")
    return registration(_pose_at(said), CENTER)


def compare_known(
    recording: UltrasoundRecording, tested: PoseEstimate | None, *_: object, in_use: bool
) -> ComparedBeat:
    """In place of `compare_beat`: the mean of what the beat's frames say; black ones say nothing."""
    begin, end = recording.peaks[-2:]
    event_s = recording.ultrasound.t_s + recording.calibrations.lag_s
    here = (event_s >= begin.t_s) & (event_s < end.t_s) & recording.ultrasound.image_valid
    here &= recording.ultrasound.stream("tracker", "probe").valid & (recording.images[:, 0, 0] > 0)
    if here.sum() < FEWEST:
        return ComparedBeat(None, None, irregular=False)
    beat = known_beat(begin.t_s, end.t_s, _pose_at(recording.images[here, 0, 0].astype(np.float64)))
    compared = None if tested is None else evaluation_of(beat, tested, in_use=in_use)
    return ComparedBeat(beat, compared, irregular=False)


def compare_breathing(
    recording: UltrasoundRecording, tested: PoseEstimate | None, *given: object, in_use: bool
) -> ComparedBeat:
    """As `compare_known`, with what the frames are known to have moved in the breath taken out."""
    breath = recording.breathing
    if breath is None or tested is None:
        return compare_known(recording, tested, *given, in_use=in_use)
    begin, end = recording.peaks[-2:]
    event_s = recording.ultrasound.t_s + recording.calibrations.lag_s
    here = (event_s >= begin.t_s) & (event_s < end.t_s)

    def beat(chosen: BoolArray) -> KnownBeat | None:
        shown = recording.images[chosen, 0, 0].astype(np.float64) - 10.0 * breath.xi_mm[chosen, 3]
        return known_beat(begin.t_s, end.t_s, _pose_at(shown)) if len(shown) >= FEWEST else None

    usable, every = beat(here & breath.usable), here & np.isfinite(breath.features).all(axis=1)
    evaluation = None if usable is None else evaluation_of(usable, tested, in_use=in_use)
    whole, learnt = beat(every), None
    if whole is not None:
        of_whole = whole.evaluate_beat(tested.pose, CENTER, in_use=in_use).measurement
        learnt = BreathEvaluation(of_whole, breath.part(np.flatnonzero(every)))
    return ComparedBeat(usable, evaluation, usable is None, learnt)


def _pose_at(said: FloatArray) -> Rigid:
    x_mm = float((said - 128).mean()) / 10
    return PoseChart(HOME, CENTER).pose(np.array([0.0, 0.0, 0.0, x_mm, 0.0, 0.0]))
