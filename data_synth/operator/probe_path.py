"""Path of the ultrasound probe: a simulated sweep over the heart, or a real path re-centred on it.

The image plane is the frame "plane": x lateral, y depth, z elevation, origin at the apex of the fan.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from data_synth.signals.smooth_noise import smooth_noise
from data_synth.signals.tracker import PosePath
from dvf_ig.core import FloatArray, InvalidInputError, PoseStream, Rigid, read_only_arrays

from .hand import perpendicular, tremor

STANDOFF_MM = (36.0, 50.0)
"""Distance of the fan apex from the heart surface over a sweep with the standard probe."""

CENTRAL_STANDOFF_MM = 48.0
"""Distance for a single view: a compromise between the width of the sector and its depth."""


@dataclass(frozen=True, slots=True)
class SweepSpec:
    """Sweep of a hand-held probe; amplitudes are of sinusoids, varied from sweep to sweep.

    Attributes:
        period_s: length of a sweep.
        orbit_deg: angle by which the apex travels around the heart, along and across.
        tilt_deg: rocking in elevation and in the image plane.
        turn_deg: rotation about the beam axis.
        variation: relative random variation of amplitudes from sweep to sweep.
    """

    period_s: float = 9.0
    orbit_deg: tuple[float, float] = (11.0, 8.0)
    tilt_deg: tuple[float, float] = (15.0, 6.0)
    turn_deg: float = 42.0
    variation: float = 0.15


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class HeartOutline:
    """Smooth outline of the heart seen from its centre.

    Attributes:
        center_mm: (3,) frame "mr".
        vertices_mm: (v, 3) outer surface.
    """

    center_mm: FloatArray
    vertices_mm: FloatArray

    def radius_mm(self, directions: FloatArray) -> FloatArray:
        """Compute (n,) radii along unit directions (n, 3): the smooth mean vertex radius within about 10°."""
        offsets = self.vertices_mm[:: max(1, len(self.vertices_mm) // 3000)] - self.center_mm
        lengths = np.linalg.norm(offsets, axis=1)
        weights = np.exp(40.0 * (np.asarray(directions) @ (offsets / lengths[:, None]).T - 1.0))
        return np.asarray(weights @ lengths / weights.sum(axis=1))


def sweeping_path(
    shape: HeartOutline,
    window: FloatArray,
    spec: SweepSpec,
    rng: np.random.Generator,
    standoff_mm: tuple[float, float] = STANDOFF_MM,
) -> PosePath:
    """Build mr_from_plane of an operator sweeping repeatedly through off-axis views.

    Args:
        window: (3,) unit direction from the heart's centre to the middle of the acoustic window.
        standoff_mm: smallest and largest distance of the fan apex from the heart surface.
    """
    up = perpendicular(window, np.array([0.0, 0.0, 1.0]))
    along = np.stack([up, np.cross(window, up)])
    base_turn = float(rng.uniform(-0.3, 0.3))
    start = rng.uniform(0, 2 * np.pi)
    gains = smooth_noise(6, 0.02, 0.06, rng)
    drift = smooth_noise(2, 0.015, 0.05, rng)
    shake = tremor(rng)

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        t = np.asarray(t_s, dtype=np.float64)
        angle = 2 * np.pi * t / spec.period_s + start
        gain = 1.0 + spec.variation * gains(t)
        wander = np.deg2rad(3.0) * drift(t)
        orbit_a = np.deg2rad(spec.orbit_deg[0]) * gain[:, 0] * np.sin(angle) + wander[:, 0]
        orbit_b = np.deg2rad(spec.orbit_deg[1]) * gain[:, 1] * np.cos(angle) + wander[:, 1]
        direction = window + np.tan(orbit_a)[:, None] * along[0] + np.tan(orbit_b)[:, None] * along[1]
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        low, high = standoff_mm
        standoff = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(0.5 * angle + 1.0) * gain[:, 2] / 1.3
        apex = shape.center_mm + direction * (shape.radius_mm(direction) + standoff)[:, None] + shake(t)
        turn = base_turn + np.deg2rad(spec.turn_deg) * gain[:, 3] * np.sin(angle + 0.9)
        elevation = np.deg2rad(spec.tilt_deg[0]) * gain[:, 4] * np.sin(2 * angle + 0.4)
        lateral = np.deg2rad(spec.tilt_deg[1]) * gain[:, 5] * np.cos(2 * angle + 1.7)
        local = Rotation.from_euler("YXZ", np.column_stack([turn, elevation, lateral])).as_matrix()
        return _looking(-direction, along[0]) @ local, apex

    return path


def _looking(beams: FloatArray, hint: FloatArray) -> FloatArray:
    """Build (n, 3, 3) with y along the unit beams (n, 3) and z close to `hint`."""
    elevation = hint - beams * (beams @ hint)[:, None]
    elevation /= np.linalg.norm(elevation, axis=1)[:, None]
    return np.stack([np.cross(beams, elevation), beams, elevation], axis=2)


def central_view(shape: HeartOutline, window: FloatArray, standoff_mm: float = CENTRAL_STANDOFF_MM) -> Rigid:
    """Build mr_from_plane looking from the middle of the window at the heart's centre."""
    rotation = _looking(-window[None], perpendicular(window, np.array([0.0, 0.0, 1.0])))[0]
    reach = float(shape.radius_mm(window[None])[0]) + standoff_mm
    return Rigid("mr", "plane", rotation, shape.center_mm + reach * window)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ReplayedPath:
    """Recorded hand motion about its own mean pose, traversed back and forth.

    Attributes:
        t_s: (n,) from 0.
        rotations, translations_mm: mean_from_probe, (n, 3, 3) and (n, 3).
        extent_mm, extent_deg: largest distance and rotation between any two poses.
    """

    t_s: FloatArray
    rotations: FloatArray
    translations_mm: FloatArray
    extent_mm: float
    extent_deg: float

    def __call__(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute mean_from_probe at any time: forwards, then backwards, without a jump."""
        length = float(self.t_s[-1])
        folded = length - np.abs(np.asarray(t_s, dtype=np.float64) % (2 * length) - length)
        rotations = Slerp(self.t_s, Rotation.from_matrix(self.rotations))(folded).as_matrix()
        shifts = [np.interp(folded, self.t_s, self.translations_mm[:, k]) for k in range(3)]
        return rotations, np.column_stack(shifts)


def replayed_path(poses: PoseStream) -> ReplayedPath:
    """Re-centre a recorded probe motion on its mean pose.

    Raises:
        InvalidInputError: fewer than 2 valid poses.
    """
    ok = np.flatnonzero(poses.valid)
    if len(ok) < 2:
        raise InvalidInputError(
            f"the probe path {poses.name} has {len(ok)} valid poses of {len(poses)}; needed at least 2"
        )
    turns = Rotation.from_matrix(poses.rotations[ok])
    mean = turns.mean()
    relative = mean.inv() * turns
    shifts = mean.inv().apply(poses.translations_mm[ok] - poses.translations_mm[ok].mean(axis=0))
    some = np.unique(np.linspace(0, len(ok) - 1, 400).astype(int))
    apart = np.linalg.norm(shifts[some, None] - shifts[None, some], axis=2)
    quaternions = relative[some].as_quat()
    cosine = np.clip(np.abs(quaternions @ quaternions.T), 0.0, 1.0)
    return ReplayedPath(
        poses.t_s[ok] - poses.t_s[ok[0]],
        relative.as_matrix(),
        shifts,
        float(apart.max()),
        float(np.degrees(2.0 * np.arccos(cosine.min()))),
    )


def acoustic_window(
    blocked: Callable[[FloatArray], FloatArray], shape: HeartOutline, preferred: FloatArray
) -> FloatArray:
    """Find the unit direction from the heart's centre with the freest view over a cone of about 35°.

    Args:
        blocked: (n, 3) mm to (n,) 1 if ultrasound does not pass (lung, bone), else 0.
        preferred: (3,) unit direction that breaks ties.
    """
    count = 240
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    ring = np.sqrt(1.0 - z**2)
    directions = np.column_stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z])
    depth = np.linspace(1.0, STANDOFF_MM[1], 14)
    points = shape.center_mm + directions[:, None] * (shape.radius_mm(directions)[:, None] + depth)[..., None]
    shut = blocked(points.reshape(-1, 3)).reshape(count, -1).mean(axis=1)
    weights = np.exp(12.0 * (directions @ directions.T - 1.0))
    score = -(weights @ shut) / weights.sum(axis=1) + 0.15 * directions @ preferred
    return np.asarray(directions[int(score.argmax())])
