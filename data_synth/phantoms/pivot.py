"""Pivot calibration recording: the tool turns about its resting tip."""

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.operator.hand import perpendicular
from data_synth.signals.smooth_noise import smooth_noise
from data_synth.signals.tracker import PosePath, TrackerSpec, sampling_times, tracked
from dvf_ig.core import FloatArray, Points, PoseStream

CONE_DEG = 32.0
"""Half-angle of the cone that the shaft sweeps: poses span more than 40°."""

TIP_PLAY_MM = 0.05
"""RMS motion of the tip in its divot."""


def pivot_recording(
    tip_in_tool: Points,
    spec: TrackerSpec,
    rng: np.random.Generator,
    *,
    seconds: float = 15.0,
) -> PoseStream:
    """Record tracker_from_tool while the shaft circles and rocks about a fixed point.

    Args:
        tip_in_tool: one point in frame "tool".
        spec: tracker errors; `rate_hz` times `seconds` poses.
    """
    true_s, stamp_s = sampling_times(spec, 0.0, seconds, rng)
    path = _pivoting(tip_in_tool.xyz_mm[0], seconds, rng)
    return tracked(path, "tracker", "tool", true_s, stamp_s, spec, rng)


def _pivoting(offset: FloatArray, seconds: float, rng: np.random.Generator) -> PosePath:
    pivot_mm = rng.uniform((-120.0, -120.0, -900.0), (120.0, 120.0, -500.0))
    base = Rotation.random(rng=rng)
    shaft = offset / np.linalg.norm(offset)
    side = perpendicular(shaft, np.array([0.0, 1.0, 0.0]))
    play = smooth_noise(3, 0.2, 1.5, rng)

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        around = 2 * np.pi * t_s / 4.5
        tilt = np.deg2rad(CONE_DEG) * (0.75 + 0.25 * np.cos(2 * np.pi * t_s / seconds))
        spin = 0.6 * np.sin(2 * np.pi * t_s / 7.0)
        axis = np.cos(around)[:, None] * side + np.sin(around)[:, None] * np.cross(shaft, side)
        turn = Rotation.from_rotvec(tilt[:, None] * axis) * Rotation.from_rotvec(spin[:, None] * shaft)
        rotations = (base * turn).as_matrix()
        tip = pivot_mm + play(t_s) * (TIP_PLAY_MM / np.sqrt(3))
        return rotations, tip - rotations @ offset

    return path
