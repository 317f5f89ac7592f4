"""Motion of the heart in breathing: a pose, and a change of shape that no pose holds; exact both ways.

At rest, which is end-expiration, nothing moves. A point x of the resting heart lies at P(t)·S(t)(x), where P
is rigid and S⁻¹(y) = y − σ(t)·d(y) is the definition of the change of shape d.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_synth.heart.beating_anatomy import BeatingAnatomy
from data_synth.heart.motion import PullBack
from data_synth.heart.reference import ReferenceMap
from data_synth.operator.pose_path import composed, inverted
from data_synth.signals.tracker import PosePath
from dvf_ig.core import BreathingTruth, FloatArray, Landmarks, ToolTruth, read_only_arrays

from .breaths import GRID_S, WARM_UP_S, Breaths, BreathSpec, lagged, with_backlash

DIRECTION = np.array([0.0, -0.29, -0.957])
"""Unit direction towards end-inspiration in LPS: down, and a little forward."""
SIDEWAYS = np.array([0.1, 0.0, 0.0])
"""Motion to the left, as a share of the excursion, which lags as the tilt does."""
TILT = np.array([[1.0, 0.0, 0.0], [0.0, 0.4, 0.0]])
"""Axes of the tilt, and of the part of it that moves with the excursion."""
TRUTH_HZ = 50.0
HEART_MM = 40.0
"""Radius at which the change of shape has its stated RMS."""
WAVES_MM = (70.0, 130.0)
"""Wave lengths of the non-rigid change of shape."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShapeChange:
    """Displacement d of the tissue at end-inspiration: affine about the centre, plus three waves.

    Attributes:
        center_mm: (3,) of the heart, frame "mr".
        gradient: (3, 3), symmetric.
        waves: (3, 3) wave vectors, rad/mm; starts: (3,) rad; sizes_mm: (3, 3) amplitudes.
    """

    center_mm: FloatArray
    gradient: FloatArray
    waves: FloatArray
    starts: FloatArray
    sizes_mm: FloatArray

    def at(self, xyz_mm: FloatArray) -> FloatArray:
        """Compute d at (n, 3) points."""
        local = xyz_mm - self.center_mm
        return np.asarray(local @ self.gradient + np.sin(local @ self.waves.T + self.starts) @ self.sizes_mm)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Breathing:
    """Motion of the heart in breathing.

    Attributes:
        spec: specification; breaths: course that drives it.
        center_mm: (3,) point about which the heart tilts.
        turn_rad, shift_mm: (n, 3) at the times of `breaths`.
        share: (n,) σ.
        shape: d.
    """

    spec: BreathSpec
    breaths: Breaths
    center_mm: FloatArray
    turn_rad: FloatArray
    shift_mm: FloatArray
    share: FloatArray
    shape: ShapeChange

    def mr_from_rest(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute P: rotations (n, 3, 3) and translations (n, 3) at any times."""
        turn = Rotation.from_rotvec(self._at(t_s, self.turn_rad)).as_matrix()
        return turn, self.center_mm + self._at(t_s, self.shift_mm) - turn @ self.center_mm

    def share_at(self, t_s: FloatArray) -> FloatArray:
        """Interpolate (n,) σ."""
        return np.interp(t_s, self.breaths.t_s, self.share)

    def points_at(self, xyz_mm: FloatArray, t_s: FloatArray) -> FloatArray:
        """Move resting points, (k, 3) for all times or (n, k, 3), to their (n, k, 3) places at (n,) times."""
        share, rest = (
            self.share_at(t_s)[:, None, None],
            np.broadcast_to(xyz_mm, (len(t_s), *xyz_mm.shape[-2:])),
        )
        shaped = rest
        for _ in range(6):
            shaped = rest + share * self.shape.at(shaped)
        turn, shift = self.mr_from_rest(t_s)
        return np.asarray(np.einsum("nij,nkj->nki", turn, shaped) + shift[:, None])

    def carried(self, rest_from_object: PosePath, held_mm: FloatArray) -> PosePath:
        """Carry a path along with the heart: the point `held_mm` (3,) of the object stays on the tissue."""
        rigid = composed(self.mr_from_rest, rest_from_object)

        def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
            turns, shifts = rest_from_object(t_s)
            moved = self.points_at((turns @ held_mm + shifts)[:, None], t_s)[:, 0]
            rotations, translations = rigid(t_s)
            return rotations, translations + (moved - (rotations @ held_mm + translations))

        return path

    def carried_contact(self, resting: ToolTruth) -> ToolTruth:
        """Carry the contact of a tool along with the heart; distances are those at rest."""
        tip_mm = self.points_at(resting.tip_mr_mm[:, None], resting.t_s)[:, 0]
        normal = np.einsum("nij,nj->ni", self.mr_from_rest(resting.t_s)[0], resting.normal)
        return replace(resting, tip_mr_mm=tip_mm, normal=normal)

    def truth(self, targets: Landmarks, seconds: float) -> BreathingTruth:
        """Tabulate the motion at TRUTH_HZ."""
        t_s = np.arange(round(seconds * TRUTH_HZ) + 1) / TRUTH_HZ
        rotations, shifts = self.mr_from_rest(t_s)
        places = self.points_at(targets.points.xyz_mm, t_s)
        return BreathingTruth(t_s, np.concatenate([rotations, shifts[:, :, None]], axis=2), places)

    def _at(self, t_s: FloatArray, columns: FloatArray) -> FloatArray:
        return np.stack([np.interp(t_s, self.breaths.t_s, column) for column in columns.T], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class ShapedAnatomy:
    """Beating heart at one moment of a breath, in the resting heart's frame: the pose of the breath undone.

    Attributes:
        resting: at end-expiration; share: σ; shape: d.
    """

    resting: BeatingAnatomy
    share: float
    shape: ShapeChange

    @property
    def reference(self) -> ReferenceMap:
        return self.resting.reference

    @property
    def inverse_motion(self) -> PullBack:
        return self

    def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        """Return (n, 3) reference positions: S⁻¹, then those of the resting heart."""
        return self.resting.inverse_motion.pull_back(xyz_mm - self.share * self.shape.at(xyz_mm), model_phase)

    def tissue(self, xyz_mm: FloatArray, model_phase: float) -> NDArray[np.uint8]:
        """Return (n,) tissue codes."""
        return self.resting.tissue(xyz_mm - self.share * self.shape.at(xyz_mm), model_phase)


def seen_at_rest(
    breathing: Breathing | None, mr_from_plane: PosePath, anatomy: BeatingAnatomy, taken_s: FloatArray
) -> tuple[PosePath, list[BeatingAnatomy | ShapedAnatomy]]:
    """Return an image's path in the frame of the resting heart, and what it shows there at (n,) times."""
    if breathing is None:
        return mr_from_plane, [anatomy] * len(taken_s)
    shares = breathing.share_at(taken_s).tolist()
    shapes: list[BeatingAnatomy | ShapedAnatomy] = [
        ShapedAnatomy(anatomy, share, breathing.shape) for share in shares
    ]
    return composed(inverted(breathing.mr_from_rest), mr_from_plane), shapes


def breathing_of(
    spec: BreathSpec, breaths: Breaths, center_mm: FloatArray, rng: np.random.Generator
) -> Breathing | None:
    """Draw how the heart follows the breaths: lags, backlash and change of shape; None without breathing."""
    if not spec.moves:
        return None
    slow, slower = rng.uniform(0.12, 0.5), rng.uniform(0.3, 0.9)
    played = with_backlash(breaths.volume, spec.backlash)
    moving = (1.0 - spec.lagging) * played + spec.lagging * lagged(lagged(played, 0.6 * slow), 0.4 * slow)
    tilting = lagged(lagged(played, 0.5 * slower), 0.5 * slower)
    moving, tilting = moving / _usual_top(moving), tilting / _usual_top(tilting)
    direction = DIRECTION / np.linalg.norm(DIRECTION)
    shift = spec.excursion_mm * (moving[:, None] * direction + tilting[:, None] * SIDEWAYS)
    turn = np.deg2rad(spec.tilt_deg) * (tilting[:, None] * TILT[0] + moving[:, None] * TILT[1])
    return Breathing(spec, breaths, center_mm, turn, shift, moving, _shape(spec, center_mm, rng))


def _usual_top(values: FloatArray) -> float:
    """Return the median of the tops before time 0, where nothing has happened yet."""
    before = values[round(0.2 * WARM_UP_S / GRID_S) : round(WARM_UP_S / GRID_S)]
    tops = before[1:-1][(before[1:-1] > before[:-2]) & (before[1:-1] >= before[2:])]
    return float(np.median(tops[tops > 0.5 * tops.max()]))


def _shape(spec: BreathSpec, center_mm: FloatArray, rng: np.random.Generator) -> ShapeChange:
    drawn = rng.standard_normal((3, 3))
    gradient = drawn + drawn.T
    gradient *= spec.stretch_mm * np.sqrt(3.0) / HEART_MM / np.linalg.norm(gradient)
    waves = rng.standard_normal((3, 3))
    waves *= 2 * np.pi / rng.uniform(*WAVES_MM, (3, 1)) / np.linalg.norm(waves, axis=1, keepdims=True)
    sizes = rng.standard_normal((3, 3))
    sizes *= spec.nonrigid_mm * np.sqrt(2.0) / np.linalg.norm(sizes)
    return ShapeChange(center_mm, gradient, waves, rng.uniform(0, 2 * np.pi, 3), sizes)
