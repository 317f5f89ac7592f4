"""Tracking of a true motion: sampling, time stamps, noise and drop-outs."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, PoseStream

PosePath = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""True motion: times (n,) to rotations (n, 3, 3) and translations (n, 3) mm of target_from_source."""


@dataclass(frozen=True, slots=True)
class TrackerSpec:
    """Errors of one tracked sensor.

    Attributes:
        rate_hz: mean sampling rate.
        jitter_s: SD of the sampling instants about the regular grid.
        stamp_noise_s: SD of the error of the written time stamps.
        position_mm: RMS 3-D position noise (each axis: divided by √3).
        rotation_deg: RMS angle of the rotation noise.
        dropouts_per_min: mean number of drop-outs a minute.
        dropout_s: (shortest, longest) drop-out.
        latency_s: delay of the stamp after the time of the pose.
        lost_s: (start, stop) pairs, true time, in which the sensor was out of sight.
    """

    rate_hz: float
    jitter_s: float = 0.0005
    stamp_noise_s: float = 0.0001
    position_mm: float = 0.2
    rotation_deg: float = 0.1
    dropouts_per_min: float = 0.0
    dropout_s: tuple[float, float] = (0.015, 0.05)
    latency_s: float = 0.0
    lost_s: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not 0.1 <= self.rate_hz <= 5000.0:
            raise InvalidInputError(f"the tracker's rate is {self.rate_hz:g} Hz; needed 0.1 to 5000 Hz")
        sizes = (self.jitter_s, self.stamp_noise_s, self.position_mm, self.rotation_deg, self.latency_s)
        if min(*sizes, self.dropouts_per_min, self.dropout_s[0]) < 0:
            raise InvalidInputError("a tracker's error is negative; needed 0 or more")
        if self.dropout_s[0] > self.dropout_s[1] or any(a >= b for a, b in self.lost_s):
            raise InvalidInputError("a tracker's drop-out ends before it begins; give (start, stop)")


def sampling_times(
    spec: TrackerSpec, start_s: float, stop_s: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draw true sampling times and their stamps, both (n,) and strictly increasing."""
    step = 1.0 / spec.rate_hz
    grid = np.arange(start_s, stop_s - 1e-9, step)
    limit = 0.4 * step
    true_s = grid + np.clip(spec.jitter_s * rng.standard_normal(len(grid)), -limit, limit)
    stamp_s = (true_s + spec.latency_s) + np.clip(
        spec.stamp_noise_s * rng.standard_normal(len(grid)), -limit / 8, limit / 8
    )
    return true_s, np.round(stamp_s, 6)


def tracked(
    path: PosePath,
    target: str,
    source: str,
    true_s: FloatArray,
    stamp_s: FloatArray,
    spec: TrackerSpec,
    rng: np.random.Generator,
) -> PoseStream:
    """Measure target_from_source: `path` at `true_s`, stamped `stamp_s`, with noise and drop-outs.

    Rotation noise acts at the sensor, on the source side; a sample that is not OK holds the identity.
    """
    rotations, translations = path(true_s)
    n = len(true_s)
    turns = rng.standard_normal((n, 3)) * (np.deg2rad(spec.rotation_deg) / np.sqrt(3))
    shifts = rng.standard_normal((n, 3)) * (spec.position_mm / np.sqrt(3))
    measured = (Rotation.from_matrix(rotations) * Rotation.from_rotvec(turns)).as_matrix()
    valid = ~_dropped(true_s, spec, rng)
    measured[~valid] = np.eye(3)
    moved = np.where(valid[:, None], translations + shifts, 0.0)
    return PoseStream(target, source, stamp_s, measured, moved, valid)


def _dropped(t_s: FloatArray, spec: TrackerSpec, rng: np.random.Generator) -> BoolArray:
    """Draw (n,) flags of a lost line of sight."""
    lost = np.zeros(len(t_s), dtype=np.bool_)
    minutes = (t_s[-1] - t_s[0]) / 60.0
    for _ in range(int(rng.poisson(spec.dropouts_per_min * minutes))):
        start = rng.uniform(t_s[0], t_s[-1])
        lost |= (t_s >= start) & (t_s < start + rng.uniform(*spec.dropout_s))
    for start, stop in spec.lost_s:
        lost |= (t_s >= start) & (t_s < stop)
    return lost
