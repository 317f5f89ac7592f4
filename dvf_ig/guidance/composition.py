"""Several fixtures, one force: forbidden regions first, guidance in what they leave, all within a cap."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats

CONFLICT_SHARE = 0.25
"""Guidance that loses more than this share of the cap to forbidden regions is in conflict with them."""
OPPOSED_SHARE = 0.5
"""Forbidden regions are in conflict where this share of their forces cancels."""
FELT_SHARE = 0.1
"""Forces below this share of the cap are in conflict with nothing."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Contribution:
    """What one fixture asks for.

    Attributes:
        force_n: (3,) N; all contributions in one frame.
        cap_n: the largest force its law gives; |force| / cap is how firmly it insists.
    """

    force_n: FloatArray
    cap_n: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "force_n", frozen_floats(self.force_n, "contributed force", (3,)))
        if not (np.isfinite(self.cap_n) and self.cap_n > 0.0):
            raise InvalidInputError(
                f"a contribution's cap is {self.cap_n:g} N; it must be positive and finite"
            )
        size = float(np.linalg.norm(self.force_n))
        if size > self.cap_n * (1.0 + 1e-9):
            raise InvalidInputError(
                f"a contribution of {size:g} N exceeds its own cap of {self.cap_n:g} N; give its law's cap"
            )

    @property
    def firmness(self) -> float:
        """f in [0, 1]: share of the cap."""
        return min(1.0, float(np.linalg.norm(self.force_n)) / self.cap_n)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Composed:
    """One force and what it cost.

    Attributes:
        force_n: (3,) N, no longer than the cap.
        forbidden_n, guidance_n: (3,) its parts: their sum is the force.
        lost_n: (3,) guidance that was taken away because it led into forbidden regions.
        saturated: True where the cap shortened either part.
        conflict: True where fixtures want opposite things: guidance leads into a forbidden region, or
            forbidden regions push against each other.
    """

    force_n: FloatArray
    forbidden_n: FloatArray
    guidance_n: FloatArray
    lost_n: FloatArray
    saturated: bool
    conflict: bool


def compose(forbidden: Sequence[Contribution], guidance: Sequence[Contribution], *, cap_n: float) -> Composed:
    """Forbidden regions before guidance; within each class the order does not matter.

    1. Forbidden forces add up, shortened to the cap.
    2. Guidance forces add up and lose what leads into a forbidden region: with n against its force and f its
       firmness, they become the x that minimises ½|x − F_g|² + ½ Σ f/(1−f)·max(0, x·n)². For one region that
       is F_g − f·max(0, F_g·n)·n (dvf_ig/docs/theory/fixtures.md); for several it has no order, is
       continuous, never longer than F_g, and at f = 1 leads into none of them.
    3. Guidance is shortened to what the forbidden force leaves of the cap, cap − |F_f|.

    Args:
        forbidden, guidance: what the fixtures ask for, in one frame.
        cap_n: largest composed force.
    Raises:
        InvalidInputError: a cap that is not positive.
    Differs from source: the cap shortens guidance before it shortens a forbidden region's push, and bounds
    the sum of lengths; the length of the sum lets guidance grow infinitely steeply beside a saturated push.
    """
    if not (np.isfinite(cap_n) and cap_n > 0.0):
        raise InvalidInputError(f"the composed cap is {cap_n:g} N; it must be positive and finite")
    pushed = _sum(forbidden)
    held = _shortened(pushed, cap_n)
    wanted = _sum(guidance)
    left = without_inward_part(wanted, forbidden)
    given = _shortened(left, max(0.0, cap_n - float(np.linalg.norm(held))))
    lost = wanted - left
    cut = bool(np.any(held != pushed) or np.any(given != left))
    clash = float(np.linalg.norm(lost)) > CONFLICT_SHARE * cap_n or _opposed(forbidden, pushed, cap_n)
    return Composed(held + given, held, given, lost, cut, clash)


def without_inward_part(force_n: FloatArray, forbidden: Sequence[Contribution]) -> FloatArray:
    """(3,) what is left of a force that must not lead into forbidden regions: step 2 of `compose`.

    The minimiser is x = F − Nλ with λ >= 0 minimising |F − Nλ|² + Σ λᵢ²(1−fᵢ)/fᵢ (N holds the nᵢ as columns),
    a non-negative least-squares problem; it is solved for λᵢ/√fᵢ, whose columns have unit length.
    """
    acting = [c for c in _ordered(forbidden) if c.firmness > 0.0]
    if not acting:
        return np.array(force_n)
    firmness = np.array([c.firmness for c in acting])
    inward = np.stack([-c.force_n / np.linalg.norm(c.force_n) for c in acting], axis=1)
    columns = inward * np.sqrt(firmness)
    matrix = np.vstack([columns, np.diag(np.sqrt(1.0 - firmness))])
    scaled, _ = nnls(matrix, np.concatenate([force_n, np.zeros(len(acting))]))
    return np.asarray(force_n - columns @ scaled)


def slew_limited(
    previous_n: FloatArray, wanted_n: FloatArray, largest_step_n: float
) -> tuple[FloatArray, bool]:
    """The wanted force, or as far towards it as one tick may go; and whether it was cut.

    Args:
        previous_n, wanted_n: (3,) N in one frame.
        largest_step_n: slew rate × tick, for example 100 N/s × 1 ms (dvf_ig/docs/theory/safety.md).
    Raises:
        InvalidInputError: a step that is not positive.
    """
    if not largest_step_n > 0.0:
        raise InvalidInputError(f"the largest step of force is {largest_step_n:g} N; it must be positive")
    change = wanted_n - previous_n
    step = _shortened(change, largest_step_n)
    return np.asarray(previous_n + step), bool(np.any(step != change))


def _ordered(contributions: Sequence[Contribution]) -> list[Contribution]:
    """In an order of their own, so that not even rounding depends on the caller's."""
    return sorted(contributions, key=lambda c: (*c.force_n.tolist(), c.cap_n))


def _sum(contributions: Sequence[Contribution]) -> FloatArray:
    rows = [c.force_n for c in _ordered(contributions)]
    return np.asarray(np.sum(rows, axis=0)) if rows else np.zeros(3)


def _shortened(force_n: FloatArray, cap_n: float) -> FloatArray:
    length = float(np.linalg.norm(force_n))
    return force_n if length <= cap_n else np.asarray(force_n * (cap_n / length))


def _opposed(forbidden: Sequence[Contribution], total_n: FloatArray, cap_n: float) -> bool:
    sizes = float(sum(np.linalg.norm(c.force_n) for c in forbidden))
    cancelled = sizes - float(np.linalg.norm(total_n))
    return cancelled > max(OPPOSED_SHARE * sizes, FELT_SHARE * cap_n)
