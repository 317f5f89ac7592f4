"""Looks at the tool: the operator turns the image plane from time to time until it contains the tip."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.signals.smooth_noise import smooth_noise
from data_synth.signals.tracker import PosePath
from dvf_ig.core import FloatArray, InvalidInputError

from .hand import minimum_jerk


@dataclass(frozen=True, slots=True)
class LookSpec:
    """Timing and manner of the operator's looks at the tip.

    Attributes:
        first_s, every_s: start of the first look, and time from one to the next.
        for_s: duration of each look; 0: the operator never looks.
        turn_s: time to turn the probe there, and back.
        off_axis_deg: the tip is brought to within this angle of the beam axis, in the image.
        wander_mm: the plane wanders about the tip by this much (standard deviation): a hand holds it.
    """

    first_s: float = 10.0
    every_s: float = 8.0
    for_s: float = 0.0
    turn_s: float = 1.2
    off_axis_deg: float = 20.0
    wander_mm: float = 1.0

    def __post_init__(self) -> None:
        if min(self.first_s, self.for_s, self.turn_s, self.off_axis_deg, self.wander_mm) < 0:
            raise InvalidInputError("a time, an angle or the wander of a look at the tool is negative")
        if self.every_s <= self.for_s + 2 * self.turn_s:
            raise InvalidInputError(
                f"looks at the tool come every {self.every_s:g} s and take "
                f"{self.for_s + 2 * self.turn_s:g} s; needed less"
            )

    def share(self, t_s: FloatArray) -> FloatArray:
        """Compute (n,) how far the probe is turned to the tool at each time, 0 to 1."""
        within = np.where(t_s < self.first_s, -1.0, (t_s - self.first_s) % self.every_s)
        there = minimum_jerk(within / max(self.turn_s, 1e-6))
        gone = minimum_jerk((within - self.turn_s - self.for_s) / max(self.turn_s, 1e-6))
        return np.asarray(np.where(within < 0, 0.0, there - gone))


def looking_at(
    path: PosePath, tip_mm: Callable[[FloatArray], FloatArray], spec: LookSpec, rng: np.random.Generator
) -> PosePath:
    """Interrupt a sweep, mr_from_plane, by looks at the tip.

    Args:
        path: mr_from_plane of the sweep.
        tip_mm: times (n,) to (n, 3) positions of the tip, frame "mr".
    """
    wander = smooth_noise(1, 0.1, 1.0, rng)

    def looking(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        t = np.asarray(t_s, dtype=np.float64)
        rotations, apex = path(t)
        x, y, z = np.einsum("nji,nj->in", rotations, tip_mm(t) - apex)
        turn = -np.arctan2(z * np.sign(x), np.abs(x))
        off = np.arctan2(np.sign(x) * np.hypot(x, z), y)
        most = np.deg2rad(spec.off_axis_deg)
        tilt = np.clip(off, -most, most) - off
        elevation = spec.wander_mm * wander(t)[:, 0] / np.linalg.norm([x, y, z], axis=0)
        there = Rotation.from_euler("YZX", np.column_stack([turn, tilt, elevation]))
        partly = Rotation.from_rotvec(there.as_rotvec() * spec.share(t)[:, None])
        return rotations @ partly.as_matrix(), apex

    return looking
