"""The streams of one clean intervention: ECG, tool and probe as stamped, and when each part arrives."""

from collections.abc import Callable
from dataclasses import dataclass, field
from heapq import merge
from operator import itemgetter

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.seeds import child_rng
from data_synth.signals.ecg import EcgSpec, synthetic_ecg
from data_synth.signals.rhythm import Beats, RhythmSpec, beat_series
from data_synth.signals.tracker import TrackerSpec, sampling_times, tracked
from dvf_ig.core import FloatArray, PoseStream, read_only_arrays
from dvf_ig.session import EcgSamples, Event, ToolPose, TrackedFrame

from .patient import ECG_HZ, HOME, TIP

TOOL_HZ, FRAME_HZ = 100.0, 12.0
TOOL_LATE_S, FRAME_LATE_S, ECG_LATE_S = 0.003, 0.030, 0.004
"""Least time from a stamp to the arrival; of the ECG, from a packet's last sample."""
ARRIVAL_JITTER_S = 0.0005
"""Mean of what comes on top of it, exponential."""
TOOL_TRACKER = TrackerSpec(rate_hz=TOOL_HZ, position_mm=0.1, rotation_deg=0.05)
PROBE_TRACKER = TrackerSpec(rate_hz=FRAME_HZ)
DEPTH_MM = 9.0
"""Of the tip in the model, along the normal of the wall, which moves from 0 to 5 mm."""
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
    """What is recorded.

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
    """What arrives in one intervention; faults change the lists."""

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
        for arrived_s, t_s, matrix in zip(arrived, stamps, _matrices(stream), strict=True)
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
        for arrived_s, t_s, matrix in zip(arrived, stamps, _matrices(stream), strict=True)
    ]


def _matrices(stream: PoseStream) -> list[FloatArray | None]:
    """(4, 4) each, read-only; None where the status was not OK."""
    matrices = np.tile(np.eye(4), (len(stream), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = stream.rotations, stream.translations_mm
    matrices.setflags(write=False)
    return [m if valid else None for m, valid in zip(matrices, stream.valid.tolist(), strict=True)]


def _late(least_s: float, n: int, rng: np.random.Generator) -> FloatArray:
    return least_s + rng.exponential(ARRIVAL_JITTER_S, n)


def _in_order(arrived_s: FloatArray) -> list[float]:
    """A link delivers in the order in which it was given."""
    ordered: list[float] = np.maximum.accumulate(arrived_s).tolist()
    return ordered
