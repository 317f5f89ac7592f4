"""Temporal calibration recording: the probe moves up and down over the floor of a water tank."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.operator.hand import reframed, tremor
from data_synth.signals.smooth_noise import smooth_noise
from data_synth.signals.tracker import PosePath, TrackerSpec, sampling_times, tracked
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import Fan, FloatArray, ImageMap, LatencyRecording, Rigid, Trace, TrackedSequence

from .tank import DOWN, tank_in_tracker
from .tank_image import wall_echoes, water_images


@dataclass(frozen=True, slots=True)
class WaterTankSpec:
    """Parameters of the motion and its images.

    Attributes:
        seconds: length of the recording on the tracker clock.
        video_hz: image rate; `video_jitter_s` is the SD of its time stamps' irregularity.
        period_s: mean period of the up-and-down motion; `variation` its relative slow change.
        amplitude_mm: mean amplitude.
        depth_mm: mean distance of the floor from the fan apex.
        row_noise_mm: SD of the detected floor along the image's rows.
        sway_mm, sway_deg: RMS of unwanted motion.
    """

    seconds: float = 25.0
    video_hz: float = 15.0
    video_jitter_s: float = 0.001
    period_s: float = 1.03
    variation: float = 0.08
    amplitude_mm: float = 10.0
    depth_mm: float = 85.0
    row_noise_mm: float = 0.3
    sway_mm: float = 0.8
    sway_deg: float = 0.6


def watertank_recording(
    probe_from_image: ImageMap,
    fan: Fan,
    lag_s: float,
    tracker: TrackerSpec,
    spec: WaterTankSpec,
    rng: np.random.Generator,
) -> LatencyRecording:
    """Record tracker_from_probe on the tracker clock and the floor's row at the fan's middle on the video's.

    An event at tracker time t is stamped t − lag_s on the video clock.
    """
    return _swept(probe_from_image, fan, lag_s, tracker, spec, rng)[0]


def watertank_images(
    probe_from_image: ImageMap,
    probe: SectorProbe,
    lag_s: float,
    tracker: TrackerSpec,
    spec: WaterTankSpec,
    rng: np.random.Generator,
) -> tuple[LatencyRecording, TrackedSequence]:
    """Make the recording of `watertank_recording` (from the same `rng`) and its images without poses."""
    recording, tank_from_plane, seen_s = _swept(probe_from_image, probe.fan, lag_s, tracker, spec, rng)
    seed = int(rng.integers(2**31))
    speckle = np.random.default_rng(seed)
    rotations, apexes = tank_from_plane(seen_s)
    frames = [
        wall_echoes(turn[2], -float(apex[2]), probe, speckle)
        for turn, apex in zip(rotations, apexes, strict=True)
    ]
    stamps = recording.wall_row_px.t_s
    seen = np.ones(len(stamps), dtype=np.bool_)
    return recording, TrackedSequence(stamps, water_images(probe, frames, seed), seen, {})


def _swept(
    probe_from_image: ImageMap,
    fan: Fan,
    lag_s: float,
    tracker: TrackerSpec,
    spec: WaterTankSpec,
    rng: np.random.Generator,
) -> tuple[LatencyRecording, PosePath, FloatArray]:
    """Simulate the recording, the true motion, and the true times of the images."""
    apex_mm = fan.apex_px * probe_from_image.scale_mm_per_px
    image_from_plane = Rigid(probe_from_image.rigid.source, "plane", np.eye(3), np.append(apex_mm, 0.0))
    plane_from_probe = (probe_from_image.rigid @ image_from_plane).inverse()
    tank_from_plane = _bobbing(spec, rng)
    path = reframed(tank_from_plane, tank_in_tracker(rng), plane_from_probe)
    true_s, stamp_s = sampling_times(tracker, 0.0, spec.seconds, rng)
    stream = tracked(path, "tracker", "probe", true_s, stamp_s, tracker, rng)
    margin_s = 0.2
    seen_s = np.arange(margin_s, spec.seconds - margin_s, 1.0 / spec.video_hz)
    seen_s += np.clip(spec.video_jitter_s * rng.standard_normal(len(seen_s)), -0.01, 0.01)
    depth = floor_depth_mm(tank_from_plane, seen_s)
    depth += spec.row_noise_mm * rng.standard_normal(len(depth))
    rows = fan.apex_px[1] + depth / probe_from_image.scale_mm_per_px[1]
    return LatencyRecording(stream, Trace(np.round(seen_s - lag_s, 6), rows)), tank_from_plane, seen_s


def floor_depth_mm(tank_from_plane: PosePath, t_s: FloatArray) -> FloatArray:
    """Compute (n,) distances along the middle line from the fan apex to the floor z = 0 of the tank."""
    rotations, apex = tank_from_plane(t_s)
    return np.asarray(-apex[:, 2] / rotations[:, 2, 1])


def _bobbing(spec: WaterTankSpec, rng: np.random.Generator) -> PosePath:
    """Draw tank_from_plane: depth axis down, one main motion with slowly changing period and amplitude."""
    start = rng.uniform(0, 2 * np.pi)
    change = smooth_noise(2, 0.05, 0.25, rng)
    sway = smooth_noise(6, 0.1, 0.6, rng)
    shake = tremor(rng)

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        t = np.asarray(t_s, dtype=np.float64)
        slow, unwanted = change(t), sway(t)
        angle = 2 * np.pi * t / spec.period_s + start + 2 * np.pi * spec.variation * slow[:, 0]
        lift = spec.amplitude_mm * (1.0 + spec.variation * slow[:, 1]) * np.sin(angle)
        apex = np.column_stack([np.zeros(len(t)), np.zeros(len(t)), spec.depth_mm + lift]) + shake(t)
        apex += unwanted[:, :3] * (spec.sway_mm / np.sqrt(3)) * np.array([1.0, 1.0, 0.2])
        rocking = Rotation.from_rotvec(unwanted[:, 3:] * (np.deg2rad(spec.sway_deg) / np.sqrt(3)))
        return (rocking * Rotation.from_matrix(DOWN)).as_matrix(), apex

    return path
