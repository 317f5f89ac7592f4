"""Rigid pose that changes once, by a stated amount: a patient moves, or a marker slips."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.operator.hand import minimum_jerk
from dvf_ig.core import FloatArray, InvalidInputError, Rigid, read_only_arrays

STEP_S = 0.02
"""Longest step of the true poses while a pose is changing."""


@dataclass(frozen=True, slots=True)
class Displacement:
    """Single change of a pose.

    Attributes:
        at_share: start of the change, as a share of the live part.
        shift_mm: exact distance of the centre's motion, in a random direction.
        turn_deg: exact angle about the centre, about a random axis.
        over_s: duration of the change; 0 is a jump.
        shift_up_to_mm: if above `shift_mm`, the distance is drawn uniformly between the two.
        wait_s: (shortest, longest) time from `at_share` to the beginning, drawn uniformly.
    """

    at_share: float = 0.5
    shift_mm: float = 0.0
    turn_deg: float = 0.0
    over_s: float = 0.0
    shift_up_to_mm: float = 0.0
    wait_s: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not 0.0 <= self.at_share <= 1.0 or not 0.0 <= self.over_s <= 60.0:
            raise InvalidInputError(
                f"a displacement begins at {self.at_share:g} of the recording and takes {self.over_s:g} s; "
                "needed 0 to 1 and 0 to 60 s"
            )
        shift_mm = (self.shift_mm, self.shift_up_to_mm)
        if not 0.0 <= min(shift_mm) <= max(shift_mm) <= 100.0 or not 0.0 <= self.turn_deg <= 90.0:
            raise InvalidInputError(
                f"a displacement is {max(shift_mm):g} mm and {self.turn_deg:g}°; needed 0 to 100 mm, 0 to 90°"
            )
        if not 0.0 <= self.wait_s[0] <= self.wait_s[1] <= 3600.0:
            raise InvalidInputError(
                f"a displacement waits {self.wait_s[0]:g} to {self.wait_s[1]:g} s; needed 0 to 3600 s, "
                "increasing"
            )

    @property
    def happens(self) -> bool:
        return max(self.shift_mm, self.shift_up_to_mm) > 0 or self.turn_deg > 0

    def drawn(self, rng: np.random.Generator) -> "Displacement":
        """Draw one distance and one waiting time from their ranges."""
        shift_mm = float(rng.uniform(self.shift_mm, max(self.shift_mm, self.shift_up_to_mm)))
        wait_s = float(rng.uniform(*self.wait_s))
        return replace(self, shift_mm=shift_mm, shift_up_to_mm=0.0, wait_s=(wait_s, wait_s))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DisplacedPose:
    """Path target_from_source: `before`, then turned and moved on the target's side.

    Attributes:
        start_s, over_s: start and duration of the change.
        turn_rad, shift_mm: (3,) rotation vector about `center_mm`, and translation, in the target frame.
    """

    before: Rigid
    start_s: float
    over_s: float
    turn_rad: FloatArray
    shift_mm: FloatArray
    center_mm: FloatArray

    def __call__(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute rotations (n, 3, 3) and translations (n, 3) at any times."""
        share = self._share(np.asarray(t_s, dtype=np.float64))[:, None]
        turn = Rotation.from_rotvec(share * self.turn_rad).as_matrix()
        offset = self.before.translation_mm - self.center_mm
        return turn @ self.before.rotation, turn @ offset + self.center_mm + share * self.shift_mm

    def steps(self) -> tuple[tuple[float, Rigid], ...]:
        """List poses with their start times; in a gradual change, the pose half-way through each step."""
        if not (self.turn_rad.any() or self.shift_mm.any()):
            return ((0.0, self.before),)
        count = int(np.ceil(self.over_s / STEP_S))
        edges = self.start_s + self.over_s * np.arange(count + 1) / max(count, 1)
        middles = [0.5 * (a + b) for a, b in pairwise(edges.tolist())]
        after_s = float(edges[-1])
        rotations, translations = self(np.array([*middles, after_s + 1.0]))
        target, source = self.before.target, self.before.source
        poses = [Rigid(target, source, r, t) for r, t in zip(rotations, translations, strict=True)]
        return ((0.0, self.before), *zip(edges.tolist(), poses, strict=True))

    def _share(self, t_s: FloatArray) -> FloatArray:
        if self.over_s == 0:
            return np.asarray(t_s >= self.start_s, dtype=np.float64)
        return minimum_jerk((t_s - self.start_s) / self.over_s)


def random_displacement(
    rng: np.random.Generator, *, shift_mm: float, turn_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Draw a rotation vector (3,) in rad and a translation (3,) in mm of exactly these sizes.

    Axis and direction are independent, and uniform over the sphere: two normalised Gaussian vectors, the axis
    drawn first.
    """
    axis, direction = rng.standard_normal((2, 3))
    turn = np.deg2rad(turn_deg) * axis / np.linalg.norm(axis)
    return turn, shift_mm * direction / np.linalg.norm(direction)


def displaced(
    before: Rigid, change: Displacement, center_mm: FloatArray, seconds: float, rng: np.random.Generator
) -> DisplacedPose:
    """Change a path as stated in a random direction and about a random axis.

    Args:
        change: without ranges, see `Displacement.drawn`.
        center_mm: (3,) point of the target frame that moves by exactly `change.shift_mm`.
        seconds: length of the live part.
    """
    turn_rad, shift_mm = random_displacement(rng, shift_mm=change.shift_mm, turn_deg=change.turn_deg)
    center = np.asarray(center_mm, dtype=np.float64)
    start_s = change.at_share * seconds + change.wait_s[0]
    return DisplacedPose(before, start_s, change.over_s, turn_rad, shift_mm, center)
