"""Composition of several fixtures into one force: forbidden regions before guidance, within one cap.

The rule is computed by `dvf_ig.kernels.composition`, which the servo loop calls too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats
from dvf_ig.core.space.frames import check_frame, require_same_frame
from dvf_ig.kernels import composition as kernel

from .laws import require_force


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Contribution:
    """Force of one fixture.

    Attributes:
        frame: frame of the force.
        force_n: (3,) N.
        cap_n: largest force of its law.
    """

    frame: str
    force_n: FloatArray
    cap_n: float

    def __post_init__(self) -> None:
        check_frame(self.frame)
        object.__setattr__(self, "force_n", frozen_floats(self.force_n, "contributed force", (3,)))
        require_force("a contribution's cap", self.cap_n)
        size = float(np.linalg.norm(self.force_n))
        if size > self.cap_n * (1.0 + 1e-9):
            raise InvalidInputError(
                f"a contribution of {size:g} N exceeds its own cap of {self.cap_n:g} N; give its law's cap"
            )

    @property
    def activation(self) -> float:
        """f in [0, 1]: |force| / cap."""
        return min(1.0, float(np.linalg.norm(self.force_n)) / self.cap_n)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Composed:
    """The composed force, its parts, and what was rejected.

    Attributes:
        frame: frame of the vectors.
        force_n: (3,) N, no longer than the cap.
        forbidden_n, guidance_n: (3,) its parts: their sum is the force.
        rejected_n: (3,) component of the guidance that was removed because it led into forbidden regions.
        saturated: True where the cap shortened either part.
        conflict: True where fixtures oppose each other: guidance leads into a forbidden region, or
            forbidden regions push against each other.
    """

    frame: str
    force_n: FloatArray
    forbidden_n: FloatArray
    guidance_n: FloatArray
    rejected_n: FloatArray
    saturated: bool
    conflict: bool


def compose(
    forbidden: Sequence[Contribution], guidance: Sequence[Contribution], *, frame: str, cap_n: float
) -> Composed:
    """Forbidden regions before guidance; within each class the order does not matter.

    1. Forbidden forces add up, shortened to the cap.
    2. Guidance forces add up, and the component into forbidden regions is rejected: with n against a region's
       force and f its activation, the sum becomes the x that minimises ½|x − F_g|² + ½ Σ f/(1−f)·max(0,
       x·n)². For one region that is F_g − f·max(0, F_g·n)·n (docs/theory/fixtures.md); for several it does
       not depend on their order, is continuous, never longer than F_g, and at f = 1 leads into none of them.
       Penalties of parallel walls add up: two at f = ½ reject 2/3 (decision 0007).
    3. Guidance is shortened to the rest of the cap, cap − |F_f|.

    Args:
        forbidden, guidance: forces of the fixtures; either may be empty.
        frame: frame of all of them and of the result.
        cap_n: largest composed force.
    Raises:
        FrameMismatchError: a contribution in another frame.
        InvalidInputError: a cap that is not positive, or larger than any device holds.
    Differs from source: the cap shortens guidance before it shortens a forbidden region's push, and bounds
    the sum of lengths; the length of the sum lets guidance grow infinitely steeply beside a saturated push.
    """
    require_force("the composed cap", cap_n)
    for contribution in (*forbidden, *guidance):
        require_same_frame(frame, contribution.frame, "composed fixtures")
    parts = (*forbidden, *guidance)
    if not parts:
        nothing = np.zeros(3)
        return Composed(frame, nothing, nothing, nothing, nothing, saturated=False, conflict=False)
    forces_n, caps_n = np.array([part.force_n for part in parts]), np.array([part.cap_n for part in parts])
    first = np.repeat([1.0, 0.0], [len(forbidden), len(guidance)])
    work, order = np.empty(kernel.work_size(len(parts))), np.empty(len(parts))
    out = np.zeros(1, kernel.COMPOSED)[0]
    kernel.compose_forces(forces_n, caps_n, first, cap_n, work, order, out)
    forbidden_n, guidance_n = out["forbidden_n"], out["guidance_n"]
    return Composed(
        frame,
        forbidden_n + guidance_n,
        forbidden_n.copy(),
        guidance_n.copy(),
        out["rejected_n"].copy(),
        saturated=bool(out["saturated"]),
        conflict=bool(out["conflict"]),
    )


def without_inward_part(force_n: FloatArray, forbidden: Sequence[Contribution]) -> FloatArray:
    """(3,) a force without its component into forbidden regions: step 2 of `compose`."""
    left = np.array(force_n, dtype=np.float64)
    if forbidden:
        forces_n, caps_n = np.array([c.force_n for c in forbidden]), np.array([c.cap_n for c in forbidden])
        count = len(forbidden)
        order = np.empty(count)
        kernel.ordered(forces_n, caps_n, order)
        kernel.without_inward_part(
            forces_n, caps_n, np.ones(count), order, left, np.empty(kernel.work_size(count))
        )
    return left
